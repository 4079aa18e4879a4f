"""The outputs of one run: a set of files under one name, and one document beside it, written last."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType

from friction_estimator.core.errors import InputError
from friction_estimator.output.journal import Journal
from friction_estimator.output.paths import StrPath, is_stream, refuse_inputs, resolved
from friction_estimator.output.staging import Refusal
from friction_estimator.output.target import Target


class RunOutput:
    """What a run writes: `--out` and `--json`, both checked and locked before any work (context manager).

    Parameters
    ----------
    out : folder or file of the set; None for none.
    refusal : why a folder that stands under `out` may not be replaced; None where `out` is a single file.
    document : file of the JSON document; None for none.
    inputs : what the run reads: no output may be one of these, hold one or lie in one.
    resumes : whether what an unfinished run has computed is kept in a journal (see `Staging`).

    Raises
    ------
    InputError on entry where an output cannot be written or would replace an input or what is not this program's.
    InUseError on entry where another process writes there.
    """

    def __init__(
        self,
        out: StrPath | None = None,
        refusal: Refusal | None = None,
        document: StrPath | None = None,
        inputs: Iterable[StrPath] = (),
        *,
        resumes: bool = False,
    ) -> None:
        self._out, self._document, self._inputs = out, document, tuple(inputs)
        self._set = None if out is None else Target(out, refusal, resumes=resumes)
        self._text = None if document is None else Target(document)
        self._held = ExitStack()

    def __enter__(self) -> "RunOutput":
        """Check both outputs, and lock them."""
        for option, path in (("--out", self._out), ("--json", self._document)):
            if path is not None and not is_stream(path):
                refuse_inputs(option, path, self._inputs)
        if self._out is not None and self._document is not None and not is_stream(self._document):
            whole, own = resolved(self._out), resolved(self._document)
            if whole in (own, *own.parents):
                raise InputError(
                    f"--json {self._document} lies in --out {self._out}, which is replaced as a whole: "
                    "name a file outside of it"
                )
        with ExitStack() as held:
            for target in (self._set, self._text):
                if target is not None:
                    held.enter_context(target)
            self._held = held.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give both up."""
        self._held.close()

    @contextmanager
    def part(self) -> Iterator[Path]:
        """Yield where to build the set, a path that does not exist yet; it is in place when the block ends well."""
        assert self._set is not None, "a run without --out has no set"
        with self._set.part() as part:
            yield part

    def journal(self) -> Journal:
        """Return the journal of what this run, or one like it that was not finished, has computed."""
        assert self._set is not None, "a run without --out has no journal"
        return Journal(self._set.journal)

    def write_document(self, text: str) -> None:
        """Write the JSON document, where one is asked for: the last thing that a run writes."""
        if self._text is not None:
            with self._text.part() as part:
                part.write_text(text, encoding="utf-8")
