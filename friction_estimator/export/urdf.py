"""URDF: the element `dynamics` of a joint."""

from typing import ClassVar

from friction_estimator.export.formats import FORMATS, Exported
from friction_estimator.export.learned import Learned
from friction_estimator.export.simplified import coulomb_viscous


@FORMATS.named("urdf")
class UrdfDynamics:
    """Damping and Coulomb friction for a joint."""

    summary: ClassVar[str] = "<dynamics damping friction> of a joint"
    needs_recording: ClassVar[bool] = True

    @staticmethod
    def write(learned: Learned) -> Exported:
        """Return the element with a comment before it."""
        found = coulomb_viscous(learned)
        comment = found.comment(
            learned,
            "Put the element into a <joint>. `friction` is the Coulomb level; simulators differ in what they make",
            "of it, and what a controller commands may bypass it.",
        )
        element = f'<dynamics damping="{found.viscous_N_s_m!r}" friction="{found.coulomb_N!r}"/>'
        return Exported(f"{comment}{element}\n", found.error_rms_N)
