"""`friction_estimator <verb>`: finds the verb's module and runs it.

Only the chosen verb's module is imported, so that `--help` answers at once.
"""

import argparse
import atexit
import difflib
import gc
import sys
from collections.abc import Sequence
from importlib import import_module

from friction_estimator import __version__
from friction_estimator.cli.progress import compilation_told
from friction_estimator.cli.terminal import EXIT_CODES, PROGRAM, Parser, guarded
from friction_estimator.core.errors import ConfigError
from friction_estimator.startup import spare_the_start

VERBS: dict[str, tuple[str, str]] = {
    # verb: (module in friction_estimator.cli, what it does)
    "simulate": ("simulate", "the rig simulation writes a recording"),
    "import": ("import_", "table (CSV, .mat, .npz, .parquet) to recording"),
    "play": ("play", "publish a recording to the live node"),
    "replay": ("replay", "the estimator over a recording, as fast as the machine goes"),
    "diagnose": ("diagnose", "what the simulation gets wrong: named cause, extended model, gain"),
    "sweep": ("sweep", "configurations over recordings, ranked where they did not learn"),
    "identify": ("identify", "batch reference fit: the best this structure can do on this record"),
    "reproduce": ("reproduce", "the paper's Figs. 3-6 and a table of its claims"),
    "export": ("export", "what was learned, for a controller or a simulator, with its error"),
    "watch": ("watch", "a live page on this machine, or a screen of text, beside a running node"),
    "info": ("info", "what a recording holds, and what can be identified from it"),
}
"""Every verb. Its module has `add_parser(subparsers)`, which adds the parser named like the verb, and `run(args)`,
which returns the exit code."""


def program() -> int:
    """Run the command line as a program, in a process of its own; return its exit code.

    A start and an end without the searches for garbage that cannot find any: a quarter of the time of a short command.
    """
    spare_the_start()
    atexit.register(gc.freeze)  # what is left goes with the process
    return main()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code. `--debug` anywhere shows the trace of a failure.

    Raises SystemExit for `--help`, `--version` (0) and usage errors (2), as argparse does.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    chosen = next((word for word in arguments if not word.startswith("-")), None)
    name = PROGRAM if chosen is None else f"{PROGRAM} {chosen}"
    # All of it inside the guard: a library that is not installed is one line, too.
    return guarded(name, lambda: _run(chosen, arguments), arguments)


def _run(chosen: str | None, arguments: list[str]) -> int:
    """Run the chosen verb."""
    parser = Parser(
        prog=PROGRAM,
        description="Online identification of seal and actuator friction beside the drive.",
        epilog=f"{PROGRAM} VERB --help shows a verb's options and an example.\n\n{EXIT_CODES}",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", parser_class=Parser)
    if chosen is not None and chosen not in VERBS:
        near = difflib.get_close_matches(chosen, VERBS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"choose one of {', '.join(VERBS)}"
        parser.error(f"unknown verb {chosen!r}: {hint}")
    for verb, (_, summary) in VERBS.items():
        if verb != chosen:
            subparsers.add_parser(verb, help=summary)
    module = None if chosen is None else import_module(f"friction_estimator.cli.{VERBS[chosen][0]}")
    if module is not None:
        module.add_parser(subparsers)
    args = parser.parse_args(arguments, argparse.Namespace(words=[PROGRAM, *arguments]))
    if module is None or args.verb is None:
        parser.error(f"no verb given: choose one of {', '.join(VERBS)}")
    try:
        with compilation_told():
            return int(module.run(args))
    except ConfigError as error:
        given = getattr(args, "config", None)
        if given and given not in str(error):  # it shows only where a model is built
            error.where = ", ".join(filter(None, (given, error.where)))
        raise


if __name__ == "__main__":
    sys.exit(program())
