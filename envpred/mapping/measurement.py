"""One future measured step by step: window of the world, movers, rays, ego, aging and fusion, compiled.

`rollout` says what is computed and why; here each step is a loop over cells.
"""

import numpy as np

from envpred.compiled import njit
from envpred.mapping.evidence import aged, combined
from envpred.mapping.rays import border_cell, first_cell, mark_ego, next_cell


@njit(nogil=True, error_model="numpy")
def roll(  # type: ignore[no-untyped-def]
    out, mass, world, seen, share, base, start, future, weights, offset, place, body, masses, numbers, cells, moved_hit
):
    """The steps of one future: see `Rollout.expected`; with a `seed` hits are drawn instead of expected.

    `weights` (N,) are those of the future at each horizon.
    What is added to `out` (N, C, H, W) is the pignistic probability of occupied (C = 1) or m(O), m(F), the chance of a
    hit and that of being seen to be free (C = 4).
    """
    forward, left, turn, resolution = place
    least, clump, remembered, seed = numbers
    _, H, W = mass.shape
    half_i, half_j = H // 2, W // 2
    now, prior = mass.copy(), np.empty_like(mass)
    hit, opaque, passed = np.empty((H, W), np.float32), np.empty((H, W), np.float32), np.empty((H, W), np.float32)
    last_i, last_j = start
    for h in range(len(future)):
        x, y, heading = future[h]
        ci, cj = int(np.floor(x + 0.5)) + offset[0], int(np.floor(y + 0.5)) + offset[1]
        corner_i, corner_j = ci - half_i, cj - half_j
        window(hit, world[h if len(world) > 1 else 0], corner_i - base[0], corner_j - base[1])
        add_movers(hit, cells[h], moved_hit[h], corner_i, corner_j)
        stop(opaque, hit, clump)
        if seed:
            seed = _draw(hit, opaque, seed)
        cos, sin = np.cos(heading), np.sin(heading)
        sensor_x = x + (forward * cos - left * sin) / resolution - corner_i
        sensor_y = y + (forward * sin + left * cos) / resolution - corner_j
        cast_rays(passed, opaque, sensor_x, sensor_y, least)
        if share[h] > 0:
            see_again(passed, seen[h if len(seen) > 1 else 0], share[h], corner_i - base[0], corner_j - base[1])
        mark_ego(passed, sensor_x, sensor_y, heading + turn, body, resolution, np.float32(-1))
        age(prior, now, ci - last_i, cj - last_j, masses[3])
        _measure(now, prior, hit, passed, masses, out[h], weights[h])
        if share[h] > 0:
            _remember(out[h], now, mass, ci - start[0], cj - start[1], weights[h] * remembered * share[h] * share[h])
        last_i, last_j = ci, cj


@njit(nogil=True)
def window(hit, world, corner_i, corner_j):  # type: ignore[no-untyped-def]
    """The part of the world that the judged grid covers."""
    H, W = hit.shape
    for i in range(H):
        hit[i] = world[corner_i + i, corner_j : corner_j + W]


@njit(nogil=True)
def add_movers(hit, cells, moved_hit, corner_i, corner_j):  # type: ignore[no-untyped-def]
    """Movers are where they have come to: the likelier of two hits stands."""
    for n in range(len(cells)):
        i, j = cells[n, 0] - corner_i, cells[n, 1] - corner_j
        if 0 <= i < hit.shape[0] and 0 <= j < hit.shape[1]:
            hit[i, j] = max(hit[i, j], moved_hit[n])


@njit(nogil=True, error_model="numpy")
def stop(opaque, hit, clump):  # type: ignore[no-untyped-def]
    """Probability that a cell stops a ray: q^2 / (q + c (1 - q)).

    What may be hit in one of many cells stops a ray once; were the cells independent, it would be stopped in each.
    """
    one = np.float32(1)
    for i in range(hit.shape[0]):
        for j in range(hit.shape[1]):
            q = hit[i, j]
            some = q + clump * (one - q)
            opaque[i, j] = q * q / some if some > 0 else q


@njit(nogil=True)
def _draw(hit, opaque, seed):  # type: ignore[no-untyped-def]
    """Draw each cell's hit, and whether it stops rays (SplitMix64, Steele et al. 2014); returns the new state."""
    zero, one = np.float32(0), np.float32(1)
    for i in range(hit.shape[0]):
        for j in range(hit.shape[1]):
            seed += np.uint64(0x9E3779B97F4A7C15)
            z = seed
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z ^= z >> np.uint64(31)
            uniform = np.float32(z >> np.uint64(40)) * np.float32(2.0**-24)
            hit[i, j] = one if uniform < hit[i, j] else zero
            opaque[i, j] = one if uniform < opaque[i, j] else zero
    return seed


@njit(nogil=True)
def see_again(passed, seen, share, corner_i, corner_j):  # type: ignore[no-untyped-def]
    """Near where the frames shown were taken, a share of what is seen is what was seen from there."""
    H, W = passed.shape
    for i in range(H):
        for j in range(W):
            passed[i, j] += share * (seen[corner_i + i, corner_j + j] - passed[i, j])


@njit(nogil=True)
def cast_rays(passed, opaque, x, y, least):  # type: ignore[no-untyped-def]
    """Transmittance of every cell, the largest over the rays from the sensor at (x, y), in cells, to the border."""
    H, W = opaque.shape
    passed[:] = 0
    seen, stops = passed.reshape(-1), opaque.reshape(-1)
    for n in range(2 * (H + W) - 4):
        target_i, target_j = border_cell(n, H, W)
        cell, steps, step_i, step_j, lead, per_i, per_j = first_cell(x, y, target_i, target_j, H, W)
        through = np.float32(1)
        for _ in range(steps):
            at = np.uint64(cell)  # unsigned: no index from the end to look for
            seen[at] = max(seen[at], through)
            through *= np.float32(1) - stops[at]
            if through < least:
                break
            cell, lead = next_cell(cell, step_i, step_j, lead, per_i, per_j)


@njit(nogil=True)
def age(prior, now, shift_i, shift_j, alpha):  # type: ignore[no-untyped-def]
    """The masses of the frame before, aged, on the present grid; cells that enter carry none."""
    _, H, W = now.shape
    prior[:] = 0
    first, end = max(0, -shift_j), min(W, W - shift_j)
    if end <= first:
        return
    for i in range(max(0, -shift_i), min(H, H - shift_i)):
        # Rows as views of their own, which the compiler takes many cells of at once.
        u, there = i + shift_i, slice(first + shift_j, end + shift_j)
        occupied, free = now[0, u, there], now[1, u, there]
        prior_occupied, prior_free = prior[0, i, first:end], prior[1, i, first:end]
        for j in range(end - first):
            a, b = aged(occupied[j], free[j], alpha)
            prior_occupied[j], prior_free[j] = a, b


@njit(nogil=True, error_model="numpy")
def _measure(now, prior, hit, passed, masses, out, weight):  # type: ignore[no-untyped-def]
    """Expected masses after the measurement; what is asked for of them is added to `out` (C, H, W) by `weight`."""
    occupied, free, ego, _ = masses
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    H, W = hit.shape
    for i in range(H):
        for j in range(W):
            a, b = prior[0, i, j], prior[1, i, j]
            under = passed[i, j] < zero
            q = one if under else hit[i, j]
            seen_free = (one - q) * (zero if under else passed[i, j])
            unseen = one - q - seen_free
            a_occupied, b_occupied = combined(a, b, ego if under else occupied, zero)
            a_free, b_free = combined(a, b, zero, free)
            a = q * a_occupied + seen_free * a_free + unseen * a
            b = q * b_occupied + seen_free * b_free + unseen * b
            now[0, i, j], now[1, i, j] = a, b
            if len(out) == 1:
                out[0, i, j] += weight * (half * a + half * (one - b))
            else:
                out[0, i, j] += weight * a
                out[1, i, j] += weight * b
                out[2, i, j] += zero if under else weight * q
                out[3, i, j] += weight * seen_free


@njit(nogil=True)
def _remember(out, now, mass, shift_i, shift_j, weight):  # type: ignore[no-untyped-def]
    """Move the forecast by `weight` towards the last frame shown: two forecasts that err apart, averaged."""
    half = np.float32(0.5)
    C, H, W = out.shape
    for i in range(max(0, -shift_i), min(H, H - shift_i)):
        for j in range(max(0, -shift_j), min(W, W - shift_j)):
            u, v = i + shift_i, j + shift_j
            occupied, free = mass[0, u, v] - now[0, i, j], mass[1, u, v] - now[1, i, j]
            if C == 1:
                out[0, i, j] += weight * half * (occupied - free)
            else:
                out[0, i, j] += weight * occupied
                out[1, i, j] += weight * free
