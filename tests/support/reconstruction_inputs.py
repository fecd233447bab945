"""The input of a reconstruction, of line integrals in memory."""

from sawmill_calibration.reconstruction.reconstruct import ReconstructionInput
from sawmill_contracts.geometry import ScannerConstants
from sawmill_vocabulary import Handedness, Rotation


def reconstruction_input(stack, fan, *, first_row=0, counts=False):
    """Of a stack (views, rows, detector) in this geometry."""
    return ReconstructionInput(
        read=lambda start, stop: stack[:, start:stop],
        angles_rad=fan.angles_rad,
        rows=(first_row, first_row + stack.shape[1]),
        scanner=ScannerConstants(**vars(fan.scanner)),
        theta=fan.theta,
        rotation=Rotation.AS_GIVEN,
        handedness=Handedness.AS_DRAWN,
        input_sha256="0" * 64,
        counts=counts,
    )
