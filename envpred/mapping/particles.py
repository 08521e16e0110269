"""Dynamic occupancy grids by particles: the PHD/MIB filter of Nuss et al. 2016; its equation numbers stand in the code.

"A random finite set approach for dynamic occupancy grid maps with real-time application" (Int. J. Robotics Research
2018).  Occupied mass is carried by particles with a velocity, free mass by the cells.  All steps are array operations
on any device.  Particles are counted on the grid with a rim one cell wide, which collects those that have left.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

from envpred.mapping.geometry import GridSpec
from envpred.mapping.matching import Matches, match
from envpred.mapping.particle_state import ParticleFilterParameters, ParticleState

UNMATCHED = 1e-3  # likelihood, beside 1 of the best, of a velocity that does not agree at all


@dataclass(frozen=True)
class DogmaGrid:
    """A dynamic occupancy grid.

    Args:
        mass: (2, H, W) posterior masses (occupied, free).
        velocity: (2, H, W) mean velocity (east, north) of a cell's persistent particles in m/s, 0 where there are none.
        covariance: (3, H, W) their covariance (xx, xy, yy) in m^2/s^2, 0 where there are none.
    """

    mass: Tensor
    velocity: Tensor
    covariance: Tensor


@dataclass(frozen=True)
class Particles:
    """Particles in the order of their cells.

    They are not moved in memory: particle k has `position[:, order[k]]` and `velocity[:, order[k]]`.

    Args:
        position: (2, M) in cells.
        velocity: (2, M) in m/s.
        order: (N,) int64.
        count: ((H+2)(W+2),) int64, how many particles each cell of the grid with its rim holds.
    """

    position: Tensor
    velocity: Tensor
    order: Tensor
    count: Tensor


def step(
    state: ParticleState,
    measured: Tensor,
    shift: Sequence[int],
    parameters: ParticleFilterParameters,
    grid: GridSpec,
    generator: torch.Generator,
) -> tuple[ParticleState, DogmaGrid]:
    """The state and the dynamic grid after one more measurement grid.

    Args:
        state: the state after the frame before, or `initial_state`.
        measured: (2, H, W) float32 measurement masses (occupied, free).
        shift: (2,) how far the grid has moved since the frame before, in cells.
        parameters: numbers of the filter.
        grid: the grid, for its resolution.
        generator: source of randomness, on the state's device.

    Raises:
        ValueError: if the shapes do not belong together or `measured` holds no masses (NaN, negative, sum > 1).
    """
    check(state, measured, shift, parameters, grid)
    persistent = sort_by_cell(*predict(state, shift, parameters, grid, generator), grid.cells)

    occupied_predicted = predict_occupied(without_rim(persistent.count, grid.cells), state.weight, parameters)
    if parameters.frame == "ground":
        # Particles from beyond the border are missing, so what has crept into the cells that enter is no prediction.
        occupied_predicted = occupied_predicted * shifted(torch.ones_like(occupied_predicted), shift)
    free = shifted(state.mass[1], shift)
    mass = combine(occupied_predicted, predict_free(free, occupied_predicted, parameters), measured)
    born, persisting = split_occupied(mass[0], occupied_predicted, parameters)

    seen = state.seen
    if parameters.matching:
        now, seen = measured[0] - measured[1], shifted(seen, shift)
        weigh(persistent, match(now, seen[0], parameters, grid), parameters, generator)
        seen = torch.cat((seen[1:], now[None]))
    newborn = give_birth(born, parameters, generator)
    # (69)-(73) without a velocity measurement: the particles of a cell share rho_p equally; likewise (74)-(80) rho_b.
    # Hence nothing is stored per particle: a cell's mass and count say what each of its particles weighs.
    velocity, covariance = moments(persistent, grid.cells)
    if parameters.neighbourhood:
        velocity, covariance = over_neighbours(velocity, covariance, persisting, parameters.neighbourhood)
    position, speed, weight = resample(persistent, persisting, newborn, born, generator)
    return (
        ParticleState(position, speed, weight, mass, seen),
        DogmaGrid(mass, velocity, covariance),
    )


def predict(
    state: ParticleState,
    shift: Sequence[int],
    parameters: ParticleFilterParameters,
    grid: GridSpec,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Positions and velocities (2, N) one period later, with constant velocity and process noise (14)."""
    N = state.position.shape[1]
    position = state.position.add(state.velocity, alpha=parameters.period / grid.resolution)
    position.add_(normal(N, generator), alpha=parameters.position_noise / grid.resolution)
    if parameters.frame == "ground":
        position.sub_(position.new_tensor(shift)[:, None])
    return position, state.velocity.add(normal(N, generator), alpha=parameters.velocity_noise)


def sort_by_cell(position: Tensor, velocity: Tensor, cells: int) -> Particles:
    """The particles at `position` with `velocity` (2, N) in the order of the cells they are in."""
    number = cell_number(position, cells)
    order = torch.sort(number, stable=True).indices
    count = torch.bincount(number, minlength=(cells + 2) ** 2)
    return Particles(position, velocity, order, count)


def cell_number(position: Tensor, cells: int) -> Tensor:
    """Number (N,) of the cell of each `position` (2, N), in the grid with its rim."""
    small = (cells + 2) ** 2 < 2**15  # short keys sort faster
    i, j = (position + 1).clamp_(0, cells + 1).to(torch.int16 if small else torch.int32)
    number: Tensor = i.mul_(cells + 2).add_(j)
    return number


def predict_occupied(count: Tensor, weight: Tensor, parameters: ParticleFilterParameters) -> Tensor:
    """Predicted m(O): the sum of a cell's weights, each times p_S (39), capped at p_S."""
    return (count * (weight * parameters.survival)).clamp(max=parameters.survival)


def predict_free(free: Tensor, occupied_predicted: Tensor, parameters: ParticleFilterParameters) -> Tensor:
    """Predicted m(F): the aged free mass, as far as the predicted m(O) leaves room (62)."""
    return torch.minimum(parameters.discount * free, 1 - occupied_predicted)


def combine(occupied: Tensor, free: Tensor, measured: Tensor) -> Tensor:
    """Dempster's rule (63): masses (2, H, W) from predicted `occupied` and `free` (H, W) and `measured` (2, H, W)."""
    unknown, unknown_measured = 1 - occupied - free, 1 - measured[0] - measured[1]
    conflict = free * measured[0] + occupied * measured[1]
    agreed_occupied = occupied * unknown_measured + unknown * measured[0] + occupied * measured[0]
    agreed_free = free * unknown_measured + unknown * measured[1] + free * measured[1]
    return torch.stack((agreed_occupied, agreed_free)) / (1 - conflict)


def split_occupied(
    occupied: Tensor, occupied_predicted: Tensor, parameters: ParticleFilterParameters
) -> tuple[Tensor, Tensor]:
    """Posterior m(O) split into what is newly born, rho_b (67), and what has persisted, rho_p (68)."""
    birth = parameters.birth * (1 - occupied_predicted)
    born = occupied * (birth / (occupied_predicted + birth))
    return born, occupied - born


def weigh(
    particles: Particles, matches: Matches, parameters: ParticleFilterParameters, generator: torch.Generator
) -> None:
    """Draw the particles of each cell anew in proportion to the likelihood of their velocity (69)-(73), in place.

    Nuss et al. keep these weights until resampling; drawn within the cells, they leave the mass of every cell as it is
    and particles that all weigh the same.

    Args:
        particles: the persistent particles; their order is changed.
        matches: measurement of velocities.
        parameters: `matching_sharpness` counts.
        generator: source of randomness.
    """
    tile = with_rim(matches.tile, -1)
    measured = (tile >= 0).nonzero().squeeze(1)
    count = particles.count.index_select(0, measured)
    cell = torch.repeat_interleave(count)  # which of the measured cells each of their particles is in
    if not len(cell):
        return
    first = particles.count.cumsum(0).index_select(0, measured) - count.cumsum(0)
    place = torch.arange(len(cell), device=cell.device) + first.index_select(0, cell)
    order = particles.order.index_select(0, place)
    surface = tile.index_select(0, measured).index_select(0, cell)
    agreement = matches.log_likelihood(select(particles.velocity, order), surface)
    likelihood = agreement.mul_(parameters.matching_sharpness).exp_().double().add_(UNMATCHED)
    total = likelihood.new_zeros(len(measured)).index_add_(0, cell, likelihood)
    share = likelihood.mul_((count / total).index_select(0, cell))
    parent = torch.repeat_interleave(apportion(share, len(cell), generator), output_size=len(cell))
    particles.order[place] = order.index_select(0, parent)


def give_birth(born: Tensor, parameters: ParticleFilterParameters, generator: torch.Generator) -> Particles:
    """New particles (74)-(80): cells get them in proportion to `born` (H, W), anywhere in the cell, at any velocity."""
    N, width = parameters.births, born.shape[1] + 2
    share = with_rim(born).double()
    count = apportion(torch.where(share.sum() > 0, share, 1), N, generator)
    cell = torch.repeat_interleave(count, output_size=N).int()
    position = torch.stack((torch.div(cell, width, rounding_mode="floor"), cell % width)) - 1
    position = position + torch.rand(position.shape, generator=generator, device=born.device)
    velocity = normal(N, generator) * parameters.birth_velocity
    velocity *= torch.rand(N, generator=generator, device=born.device) >= parameters.birth_standing
    return Particles(position, velocity, torch.arange(N, device=born.device), count)


def moments(particles: Particles, cells: int) -> tuple[Tensor, Tensor]:
    """Mean velocity (2, H, W) and covariance (3, H, W) of the particles of each cell, which weigh the same."""
    x, y = particles.velocity
    first = particles.count.cumsum(0) - particles.count
    table = x.new_empty(len(x), 5)
    for column, values in enumerate((x, y, x * x, x * y, y * y)):  # on one thread, stacking takes twice as long
        table[:, column] = values
    # Sums over the particles of one cell at a time: few enough for single precision.
    sums = embedding_bag(particles.order, table, first, mode="sum")
    x, y, xx, xy, yy = (without_rim(mean, cells) for mean in (sums / particles.count.clamp(min=1)[:, None]).T)
    covariance = torch.stack(((xx - x * x).clamp_(min=0), xy - x * y, (yy - y * y).clamp_(min=0)))
    return torch.stack((x, y)), covariance


def over_neighbours(velocity: Tensor, covariance: Tensor, weight: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Mean velocity (2, H, W) and covariance (3, H, W) of the particles within `cells` of each cell, itself included.

    Args:
        velocity: (2, H, W) means of the single cells.
        covariance: (3, H, W) covariances of the single cells.
        weight: (H, W) what the particles of each cell weigh together.
        cells: how far, along either axis.
    """
    mixed = covariance + outer(velocity)  # second moments add up, covariances do not
    sums = torch.cat((velocity, mixed, torch.ones_like(weight)[None])) * weight
    sums = box_sum(sums, cells)
    holds = (covariance[0] > 0) | (velocity[0] != 0)  # cells without particles stay without a velocity
    sums = sums[:5] / sums[5].clamp(min=1e-6) * holds
    mean = sums[:2]
    spread = sums[2:] - outer(mean)
    return mean, torch.stack((spread[0].clamp(min=0), spread[1], spread[2].clamp(min=0)))


def box_sum(fields: Tensor, cells: int) -> Tensor:
    """Sums of `fields` (C, H, W) over the square of cells within `cells` of each; cells outside the grid are 0."""
    for axis in (1, 2):
        length = fields.shape[axis]
        padded = pad(fields, (0, 0, cells, cells) if axis == 1 else (cells, cells))
        fields = padded.narrow(axis, 0, length).clone()
        for k in range(1, 2 * cells + 1):
            fields.add_(padded.narrow(axis, k, length))
    return fields


def outer(velocity: Tensor) -> Tensor:
    """Products (xx, xy, yy) of the components of `velocity` (2, H, W)."""
    x, y = velocity
    return torch.stack((x * x, x * y, y * y))


def resample(
    persistent: Particles, persisting: Tensor, newborn: Particles, born: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Positions and velocities (2, N) drawn from persistent and newborn particles, and the weight () that each has.

    Systematic sampling in the order of the cells: each cell gets children in proportion to its mass, to within one,
    evenly from its particles.
    """
    N, births = persistent.velocity.shape[1], newborn.velocity.shape[1]
    count = torch.cat((persistent.count, newborn.count))
    mass = torch.cat((with_rim(persisting), with_rim(born))).double()
    total = torch.where(count > 0, mass, 0).sum()  # what no particle carries cannot be drawn
    share = torch.where(total > 0, mass / count.clamp(min=1), 1)
    children = apportion(torch.repeat_interleave(share, count, output_size=N + births), N, generator)
    parent = torch.repeat_interleave(children, output_size=N)
    parent = torch.cat((persistent.order, newborn.order + N)).index_select(0, parent)
    position = select(torch.cat((persistent.position, newborn.position), 1), parent)
    velocity = select(torch.cat((persistent.velocity, newborn.velocity), 1), parent)
    return position, velocity, (total / N).float()


def apportion(share: Tensor, total: int, generator: torch.Generator) -> Tensor:
    """How many (M,) int64 of `total` each of M parties gets, in proportion to `share` (M,) float64, systematically."""
    u = torch.rand((), generator=generator, device=share.device, dtype=torch.float64)
    reached = share.cumsum(0)
    reached.mul_(total / reached[-1]).add_(u)
    counts = reached.int().clamp_(max=total)  # rounding may reach beyond the total
    counts[-1] = total
    return counts.diff(prepend=counts.new_zeros(1))


def select(rows: Tensor, index: Tensor) -> Tensor:
    """`rows[:, index]` (2, N), row by row, which a CPU does faster."""
    out = rows.new_empty(len(rows), len(index))
    for row, into in zip(rows, out, strict=True):
        torch.index_select(row, 0, index, out=into)
    return out


def normal(count: int, generator: torch.Generator) -> Tensor:
    """Standard normal numbers (2, count), on the generator's device, to be read only.

    A stretch of a fixed table from a random place on: to draw every number anew is what a filter on a CPU would spend
    most of its time on.  The numbers of one particle, and those of the particles of one cell, are independent of each
    other all the same.
    """
    table = normal_table(max(2**20, 4 * count), generator.device)
    start = int(torch.randint(len(table) - 2 * count, (), generator=generator, device=generator.device))
    return table[start : start + 2 * count].view(2, count)


@cache
def normal_table(size: int, device: torch.device) -> Tensor:
    """Independent standard normal numbers (size,), the same ones on every device."""
    with torch.inference_mode(mode=False):
        return torch.randn(size, generator=torch.Generator().manual_seed(0)).to(device)


def with_rim(field: Tensor, fill: int = 0) -> Tensor:
    """`field` (H, W) with a rim of `fill`, flat."""
    return pad(field, (1, 1, 1, 1), value=fill).flatten()


def without_rim(flat: Tensor, cells: int) -> Tensor:
    """The grid (H, W) in a `flat` one with its rim."""
    return flat.view(cells + 2, cells + 2)[1:-1, 1:-1]


def shifted(field: Tensor, shift: Sequence[int]) -> Tensor:
    """`field` (..., H, W) on a grid that has moved on by `shift` cells; cells that enter are 0."""
    moved = torch.zeros_like(field)
    (to_i, from_i), (to_j, from_j) = (_overlap(int(s), n) for s, n in zip(shift, field.shape[-2:], strict=True))
    moved[..., to_i, to_j] = field[..., from_i, from_j]
    return moved


def _overlap(shift: int, size: int) -> tuple[slice, slice]:
    """Where the new grid's part of the old one goes, and where it comes from."""
    kept = max(size - abs(shift), 0)
    to = min(max(-shift, 0), size)
    origin = min(max(shift, 0), size)
    return slice(to, to + kept), slice(origin, origin + kept)


def check(
    state: ParticleState,
    measured: Tensor,
    shift: Sequence[int],
    parameters: ParticleFilterParameters,
    grid: GridSpec,
) -> None:
    """Refuse what does not belong together."""
    if measured.shape != state.mass.shape or measured.shape != (2, grid.cells, grid.cells) or len(shift) != 2:
        raise ValueError(
            f"measured masses (2,{grid.cells},{grid.cells}) like the state's and a shift (2,) expected, "
            f"not {tuple(measured.shape)}, {tuple(state.mass.shape)} and ({len(shift)},)"
        )
    if state.position.shape != (2, parameters.persistent) or state.velocity.shape != state.position.shape:
        raise ValueError(
            f"positions and velocities (2,{parameters.persistent}) expected, "
            f"not {tuple(state.position.shape)} and {tuple(state.velocity.shape)}"
        )
    if state.seen.shape != (parameters.matching, *measured.shape[1:]):
        raise ValueError(
            f"{parameters.matching} grids seen before expected for matching, not {tuple(state.seen.shape)}"
        )
    # Comparisons with "not a number" are false, so this finds it as well.
    if not bool((measured >= 0).all() & (measured.sum(0) <= 1 + 1e-6).all()):
        raise ValueError("measured masses must be numbers of at least 0 that sum to at most 1 in every cell")
