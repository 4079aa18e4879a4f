"""Turn the lines of `study.py` into the table: `python table.py LINES.jsonl... [--list]`."""

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

PHYSICAL = {
    "sensor_bias": ["bias"],
    "bias_step": ["step", "at"],
    "gain_step": ["step", "at"],
    "sensor_drift": ["total"],
    "viscosity_drift": ["drop", "time_constant"],
    "wear": ["change", "length"],
    "breakaway": ["length"],
    "presliding": ["amplitude", "length"],
    "backlash": ["gap"],
    "frictional_lag": ["lag"],
    "time_delay": ["delay"],
    "sensor_lowpass": ["time_constant"],
    "inertia": ["mass"],
    "side_spring": ["stiffness"],
    "squeeze_film": ["amplitude", "speed"],
    "viscoelastic_relaxation": ["stiffness", "time_constant"],
    "position_dependence": ["wavelength"],
    "periodic_disturbance": ["frequency"],
    "pressure_dependence": ["boundary"],
    "direction_asymmetry": ["asymmetry"],
    "saturation": ["level"],
    "quantization": ["step"],
    "velocity_noise": ["deviation"],
    "dropout": ["fraction"],
    "outliers": ["amplitude"],
    "stick_slip": ["decay"],
}


def read(paths: list[Path]) -> list[dict[str, Any]]:
    return [json.loads(line) for path in paths for line in path.read_text().splitlines()]


def singles(lines: list[dict[str, Any]], show: bool) -> None:
    groups = defaultdict(list)
    for line in lines:
        groups[line["size"], line["noise"]].append(line)
    for key, group in sorted(groups.items(), reverse=True):
        first = np.array([bool(x.get("effects")) and x["effects"][0]["name"] == x["truth"][0] for x in group])
        inset = np.array(
            [
                bool(x.get("effects")) and x["truth"][0] in [x["effects"][0]["name"], *x["effects"][0]["rivals"]]
                for x in group
            ]
        )
        size = [1 + len(x["effects"][0]["rivals"]) for x in group if x.get("effects")]
        wrong = sum(
            sum(e["name"] not in x["truth"] and x["truth"][0] not in e["rivals"] for e in x.get("effects", []))
            for x in group
        )
        flagged = np.mean([x.get("remainder") is not None for x in group])
        recovered = [r for x in group if (r := recovery(x)) is not None]
        print(
            f"size {key[0]:5} noise {key[1]:4}: n {len(group):3d}  first {100 * first.mean():5.1f} %  "
            f"in set {100 * inset.mean():5.1f} %  set size {np.mean(size):.2f}  "
            f"wrong names {100 * wrong / len(group):4.1f} %  "
            f"flagged {100 * flagged:4.1f} %  recovered {100 * np.median(recovered) if recovered else np.nan:5.1f} %"
        )
        if show:
            for x, good in zip(group, first, strict=True):
                if not good or "error" in x or len(x["effects"]) > 1 or x["remainder"]:
                    named = [(e["name"], e["rivals"]) for e in x.get("effects", [])]
                    print(
                        "     ",
                        x["truth"],
                        x["seed"],
                        x.get("spec"),
                        named,
                        x.get("remainder"),
                        x.get("error", "")[-200:],
                    )
    coverage(lines, show)


def recovery(x: dict[str, Any]) -> float | None:
    """Share of the excess error power over the true noise that the first effect recovers, on held-out data."""
    if not x.get("effects") or x["effects"][0]["name"] != x["truth"][0]:
        return None
    before, after = x["effects"][0]["before"], x["effects"][0]["after"]
    excess = before**2 - x["noise_rms"] ** 2
    if after >= before or excess <= 0:
        return None
    return float(np.clip(1.0 - (after**2 - x["noise_rms"] ** 2) / excess, -1.0, 1.2))


def coverage(lines: list[dict[str, Any]], show: bool) -> None:
    rows = defaultdict(list)
    for x in lines:
        if not x.get("effects") or x["effects"][0]["name"] != x["truth"][0]:
            continue
        for name in PHYSICAL.get(x["truth"][0], []):
            got, true = x["effects"][0]["parameters"].get(name), x["true"][0].get(name)
            if got is None or true is None:
                continue
            inside = got[1] <= true <= got[2]
            near = abs(got[0] - true) <= 0.1 * abs(true)
            rows[x["truth"][0], name].append((inside, near or inside, x["true"][0].get("form", 0.0), got[0] / true))
    every = [r for group in rows.values() for r in group]
    if every:
        usual = [r for r in every if not r[2]]
        print(
            f"intervals cover {100 * np.mean([r[0] for r in every]):.1f} % (n {len(every)}); "
            f"in the regressor's own form {100 * np.mean([r[0] for r in usual]):.1f} % (n {len(usual)}); "
            f"within 10 % or inside: {100 * np.mean([r[1] for r in every]):.1f} %, "
            f"own form {100 * np.mean([r[1] for r in usual]):.1f} %"
        )
    if show:
        for (effect, name), group in sorted(rows.items()):
            own = [r for r in group if not r[2]]
            other = [r for r in group if r[2]]
            ratio = " ".join(f"{r[3]:.3f}{'' if r[0] else '!'}{'*' if r[2] else ''}" for r in group[:12])
            print(
                f"   {effect}.{name}: cover {sum(r[0] for r in own)}/{len(own)} "
                f"other {sum(r[0] for r in other)}/{len(other)}  {ratio}"
            )


def report(lines: list[dict[str, Any]], show: bool = False) -> None:
    kinds = defaultdict(list)
    for line in lines:
        kinds[line["kind"]].append(line)
    for kind, group in kinds.items():
        print(
            f"== {kind}: {len(group)} records, {sum('error' in x for x in group)} errors, "
            f"median {np.median([x.get('seconds', np.nan) for x in group]):.1f} s"
        )
        if kind == "single":
            singles(group, show)
            for name in ("presliding", "backlash", "time_delay"):
                got = [
                    r for x in group if x["truth"] == [name] and x["size"] == 0.04 and (r := recovery(x)) is not None
                ]
                print(f"   recovered, {name}: {', '.join(f'{100 * r:.0f}' for r in got)} %")
        elif kind in ("nothing", "coloured"):
            calm = np.mean([x.get("verdict") == "nothing_found" for x in group])
            flags = np.mean([x.get("remainder") is not None for x in group])
            print(f"   nothing_found {100 * calm:.1f} %, flagged {100 * flags:.1f} %")
            for x in group:
                if x.get("effects") or x.get("remainder") or "error" in x:
                    print(
                        "     ",
                        x["seed"],
                        x["noise"],
                        [e["name"] for e in x.get("effects", [])],
                        x.get("remainder"),
                        x.get("error", "")[-200:],
                    )
        elif kind == "catalogue":
            flagged = np.mean([x.get("remainder") is not None for x in group])
            print(f"   flagged {100 * flagged:.1f} %")
            if show:
                for x in group:
                    print(
                        "     ",
                        x["truth"][0],
                        x["seed"],
                        [e["name"] for e in x.get("effects", [])],
                        x.get("remainder"),
                        f"{x.get('unexplained', np.nan):.0f}",
                    )
        elif kind == "pairs":
            found = [
                [bool(any(t in [e["name"], *e["rivals"]] for e in x.get("effects", []))) for t in x["truth"]]
                for x in group
            ]
            spurious = [
                sum(
                    e["name"] not in x["truth"] and not set(e["rivals"]) & set(x["truth"]) for e in x.get("effects", [])
                )
                for x in group
            ]
            print(
                f"   one {100 * np.mean([any(f) for f in found]):.0f} %, "
                f"both {100 * np.mean([all(f) for f in found]):.0f} %, spurious {np.mean(spurious):.2f}"
            )
            if show:
                for x in group:
                    print(
                        "     ",
                        x["seed"],
                        x["truth"],
                        [(e["name"], e["rivals"]) for e in x.get("effects", [])],
                        x.get("remainder"),
                        x.get("error", "")[-200:],
                    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lines", type=Path, nargs="+")
    parser.add_argument("--list", action="store_true")
    given = parser.parse_args()
    report(read(given.lines), given.list)
