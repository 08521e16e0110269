"""The grid that drives ask for in their own settings, where the command line leaves it at its default."""

from collections.abc import Sequence
from dataclasses import replace

from envpred.drives import Drive
from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters


def as_stated(
    drives: Sequence[Drive], parameters: MappingParameters, context: int | None
) -> tuple[MappingParameters, int | None]:
    """`parameters` and `context` as all of `drives` ask for them, where nobody else does.

    Raises:
        UserError: if drives ask for different grids, which one store cannot hold.
    """
    if parameters.grid == GridSpec():
        grids = {drive.grid or GridSpec() for drive in drives}
        if len(grids) > 1:
            told = " and ".join(sorted(f"{grid.cells} cells of {grid.resolution:.4g} m" for grid in grids))
            raise UserError(
                f"drives ask for {told}, and a store holds one grid; choose drives by --drives, or change their grids"
            )
        parameters = replace(parameters, grid=next(iter(grids), parameters.grid))
    if context is None:
        contexts = {drive.context for drive in drives}
        context = contexts.pop() if len(contexts) == 1 else None
    return parameters, context
