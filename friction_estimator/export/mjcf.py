"""MJCF: joint attributes for MuJoCo, as a default class."""

from typing import ClassVar

from friction_estimator.export.formats import FORMATS, Exported
from friction_estimator.export.learned import Learned
from friction_estimator.export.simplified import coulomb_viscous

SOLIMPFRICTION = "0.9999 0.9999 0.001"
"""With the solver's default impedance a joint below breakaway creeps by about 1e-3 F/m in a second; this makes it a
thousand times less."""

SOLREFFRICTION = "0.001 1"
"""Time constant of the friction constraint, s; the solver takes two of its steps where these are longer. With the
default of 0.02 s friction is viscous below 0.01 F/m, and a coasting mass takes three times too long to rest."""


@FORMATS.named("mjcf")
class MujocoJoint:
    """Friction loss and damping as a default class."""

    summary: ClassVar[str] = "MuJoCo's joint attributes frictionloss and damping, as a default class"
    needs_recording: ClassVar[bool] = True

    @staticmethod
    def write(learned: Learned) -> Exported:
        """Return a model that holds the class only: <include> it, and name the class in a joint."""
        found = coulomb_viscous(learned)
        comment = found.comment(
            learned,
            '<include file="..."/> this file into a model, and give its joint class="learned_friction".',
            "solimpfriction keeps the joint from creeping below breakaway, solreffriction from coasting on.",
        )
        joint = (
            f'<joint frictionloss="{found.coulomb_N!r}" damping="{found.viscous_N_s_m!r}" '
            f'solimpfriction="{SOLIMPFRICTION}" solreffriction="{SOLREFFRICTION}"/>'
        )
        text = (
            f"{comment}<mujoco>\n  <default>\n"
            f'    <default class="learned_friction">\n      {joint}\n    </default>\n'
            "  </default>\n</mujoco>\n"
        )
        return Exported(text, found.error_rms_N)
