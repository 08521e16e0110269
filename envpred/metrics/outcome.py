"""What a target says happened in a cell: occupied, free, or nothing known."""

from torch import Tensor

EVEN = 0.5  # the pignistic probability of a cell about which there is no evidence


def occupied(probability: Tensor) -> Tensor:
    """Cells more likely occupied than free; a cell without evidence (0.5) is not."""
    return probability > EVEN


def outcome(probability: Tensor) -> Tensor:
    """0 free, 1 occupied, 2 no evidence: int32 of `probability`'s shape."""
    return occupied(probability).int() + 2 * (~known(probability)).int()


def known(probability: Tensor) -> Tensor:
    """Cells with evidence for one side: in the others there is no outcome that a forecast could be judged by."""
    return probability != EVEN
