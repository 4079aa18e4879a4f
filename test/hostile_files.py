"""Files that broke something once, the verbs that read their kind, and how each must end.

Shared by the suite (in one process) and `hard_hostile.py` (a process each, bounded in memory and time).
"""

from dataclasses import dataclass
from pathlib import Path

DEMO = Path(__file__).parents[1] / "bags" / "demo"
MAP = ["--time", "t", "--map", "velocity=v,friction=f"]
OUT = "OUT"
"""Stands in `Case.words` for a path that does not exist yet."""


@dataclass(frozen=True)
class Case:
    """One file for one verb.

    Attributes
    ----------
    file : name in the folder of hostile files.
    verb : of the command line.
    code : exit code; 0 where the answer is sound (what cannot be used is left out and told), 1 where the data cannot
        answer, 2 where the file is refused.
    says : what the answer holds beside the file's name.
    """

    file: str
    verb: str
    code: int = 2
    says: str = ""

    @property
    def id(self) -> str:
        return f"{self.verb}-{self.file}"

    def words(self, folder: Path, out: Path) -> list[str]:
        """Return the command line."""
        path = str(folder / self.file)
        if self.file.endswith(".yaml"):
            return [self.verb, str(DEMO), "--config", path, *([] if self.verb == "info" else ["--out", str(out)])]
        if self.verb == "import":
            return ["import", path, "--out", str(out), *MAP]
        return [self.verb, path, *([] if self.verb == "info" else ["--out", str(out)])]

    def faults(self, code: int, out: str, error: str, written: bool) -> list[str]:
        """Return in what an ending differs from what is promised."""
        found = []
        if code != self.code:
            found.append(f"exit code {code}, not {self.code}")
        if not all(c.isprintable() for c in (out + error).replace("\n", "")):
            found.append("a control character reached the terminal")
        if "Traceback" in error:
            found.append("a trace")
        if code == 2 and (error.count("\n") != 1 or self.file not in error):
            found.append("not one line that names the file")
        if code == 2 and written:
            found.append("something was written")
        if self.says not in out + error:
            found.append(f"{self.says!r} is not said")
        return found


def _recordings(name: str, codes: str, says: str = "") -> list[Case]:
    return [
        Case(name, verb, int(code), says)
        for verb, code in zip(("info", "replay", "identify", "diagnose"), codes, strict=True)
    ]


def _settings(name: str, says: str = "") -> list[Case]:
    return [Case(name, verb, 2, says) for verb in ("info", "replay")]


CASES = [
    *_recordings("declared_2gb_header.mcap", "2222", "is damaged"),
    *_recordings("declared_2gb_message.mcap", "2222", "is damaged"),
    *_recordings("dotdot", "2222", "metadata.yaml"),
    *_recordings("inttype", "2222", "type is 1.5, expected text"),
    *_recordings("names.mcap", "0001"),
    *_recordings("num_p1e308.mcap", "0000"),
    *_recordings("num_x1e308.mcap", "0000"),
    Case("num_f1e-300.mcap", "info", 0, "friction is constant at 0 N"),
    *_recordings("num_f1e-300.mcap", "0111", "friction is constant at 0 N")[1:],
    Case("esc.csv", "import", 0, "1 samples"),
    Case("inf.csv", "import", 0, "1 infinite time"),
    Case("pinf.csv", "import", 0, "1 infinite time"),
    Case("vinf.csv", "import", 0, "2 infinite velocity"),
    Case("m1e18.csv", "import", 2, "--time t runs from -1e+18 to 3 s"),
    Case("m1e300.csv", "import", 2, "--time t runs from -1e+300 to 3 s"),
    Case("theory_300.csv", "import", 2, "no column 't'"),
    *(Case(f"segv_v5_{name}.mat", "import", 2) for name in ("28_0", "48_0", "48_14")),
    *(
        case
        for name, says in {
            "y_5000": "more than 64 bits",
            "y_date": "unknown parameter x",
            "y_deep": "",
            "y_dict": "fir.order",
            "y_ext": "",
            "y_hugeint": "more than 64 bits",
            "y_laughs": "",
            "y_laughs_list": "",
            "y_merge": "more than 50000 values",
            "y_nul": "a NUL",
            "y_range": "basis.velocity_range",
            "y_rec": "refers to itself",
            "y_sur": "surrogate",
            "y_tagbool": "neither true nor false",
            "y_tagint": "is no integer",
            "y_ts": "timestamp",
            "y_unit": "basis.velocity_unit",
        }.items()
        for case in _settings(f"{name}.yaml", says)
    ),
]
