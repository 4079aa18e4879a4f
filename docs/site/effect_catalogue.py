"""The catalogue of effects: words, equation, picture and rivals of each, from its class alone."""

from pathlib import Path

import effect_pictures

from friction_estimator.core.quantities import LINEAR, Quantities
from friction_estimator.effects.base import EFFECTS, Effect, Key
from friction_estimator.effects.catalogue import equation
from friction_estimator.effects.trace import STAGES

TITLES = {
    "lubrication": "The lubricating film",
    "friction": "The contact",
    "mechanics": "What else the force sensor feels",
    "transmission": "Timing between force and velocity",
    "sensor": "Sensors",
    "stamps": "Clocks and stamps",
}


def markdown(folder: Path, address: str) -> str:
    """Return the catalogue, an overview and one section an effect, and draw the pictures into `folder`/effects."""
    pictures = folder / "effects"
    pictures.mkdir(exist_ok=True)
    ordered = sorted(EFFECTS.values(), key=lambda cls: STAGES.index(cls.stage))
    parts = ["| effect | what is true |", "| --- | --- |"]
    parts += [f"| [{plain(cls.name)}](#effect-{cls.name}) | {_words(cls, cls.words.what)} |" for cls in ordered]
    for stage in STAGES:
        parts += ["", f"## {TITLES[stage]}", ""]
        for cls in ordered:
            if cls.stage == stage:
                parts += _section(cls, effect_pictures.draw(cls, pictures), address)
    return "\n".join(parts)


def plain(name: str) -> str:
    """Return the plain name of an effect's id."""
    return name.replace("_", " ")


def _section(cls: type[Effect], picture: Path, address: str) -> list[str]:
    formula, rest = equation(cls)
    parts = [f"(effect-{cls.name})=", f"### {plain(cls.name).capitalize()}", ""]
    parts += [
        f"{_sentence(_words(cls, cls.words.what))} As an option: `--effect {cls.name}`",
        "",
        "```text",
        formula,
        "```",
        "",
    ]
    parts += [rest, ""] if rest else []
    parts += [f"![{plain(cls.name)}: signal and residual]({address}/effects/{picture.name})", ""]
    parts += [f"**How to see it.** {_sentence(_words(cls, cls.words.where))}"]
    if cls.channel:
        parts += [f"It is named only where the {cls.channel} is recorded."]
    parts += ["", "| key | default | unit | range | meaning |", "| --- | --- | --- | --- | --- |"]
    parts += [_key(cls, key) for key in cls.keys]
    if cls.words.confused_with:
        parts += ["", "| may be taken for | what separates the two |", "| --- | --- |"]
        parts += [
            f"| [{plain(rival)}](#effect-{rival}) | {_words(cls, experiment)} |"
            for rival, experiment in cls.words.confused_with.items()
        ]
    return [*parts, ""]


def _words(cls: type[Effect], text: str) -> str:
    return _quantities(cls).worded(text).replace("|", "\\|")


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _key(cls: type[Effect], key: Key) -> str:
    unit = _quantities(cls).unit(key.unit)
    return f"| `{key.name}` | {key.default:g} | {unit} | {key.low:g} to {key.high:g} | {_words(cls, key.description)} |"


def _quantities(cls: type[Effect]) -> Quantities:
    return Quantities(effect_pictures.MOTION.get(cls.name, LINEAR))
