"""How a rollout changes with its world: the steps of `measurement` backwards, to train a network through them.

The gradient goes through fusion, aging, free space and rays.  Of the rays of a cell the most transparent one counts, as
forwards; movers and what was seen from where the last frame was taken are given.
"""

import numpy as np

from envpred.compiled import njit
from envpred.mapping.evidence import combined
from envpred.mapping.measurement import add_movers, age, cast_rays, see_again, stop, window
from envpred.mapping.rays import border_cell, first_cell, mark_ego, next_cell


@njit(nogil=True, error_model="numpy")
def roll_back(  # type: ignore[no-untyped-def]
    out,
    gradient,
    mass,
    world,
    seen,
    share,
    base,
    start,
    future,
    weights,
    offset,
    place,
    body,
    masses,
    numbers,
    cells,
    moved_hit,
):
    """Add the gradient of one future by the world to `out`, as `world`; arguments as `roll`, which see.

    `gradient` (N, C, H, W) is that of what `roll` adds up.
    """
    forward, left, turn, resolution = place
    least, clump, remembered, _ = numbers
    N, C, H, W = gradient.shape
    half_i, half_j = H // 2, W // 2
    hits, rays = np.empty((N, H, W), np.float32), np.empty((N, H, W), np.float32)
    passes, priors = np.empty((N, H, W), np.float32), np.empty((N, 2, H, W), np.float32)
    corners, sensors = np.empty((N, 2), np.int64), np.empty((N, 2), np.float64)
    now, opaque = mass.copy(), np.empty((H, W), np.float32)
    last_i, last_j = start
    for h in range(N):
        x, y, heading = future[h]
        corner_i, corner_j = int(np.floor(x + 0.5)) + offset[0] - half_i, int(np.floor(y + 0.5)) + offset[1] - half_j
        corners[h] = corner_i, corner_j
        hit, passed = hits[h], passes[h]
        window(hit, world[h if len(world) > 1 else 0], corner_i - base[0], corner_j - base[1])
        add_movers(hit, cells[h], moved_hit[h], corner_i, corner_j)
        stop(opaque, hit, clump)
        cos, sin = np.cos(heading), np.sin(heading)
        sensors[h, 0] = x + (forward * cos - left * sin) / resolution - corner_i
        sensors[h, 1] = y + (forward * sin + left * cos) / resolution - corner_j
        cast_rays(passed, opaque, sensors[h, 0], sensors[h, 1], least)
        rays[h] = passed
        if share[h] > 0:
            see_again(passed, seen[h if len(seen) > 1 else 0], share[h], corner_i - base[0], corner_j - base[1])
        mark_ego(passed, sensors[h, 0], sensors[h, 1], heading + turn, body, resolution, np.float32(-1))
        age(priors[h], now, corner_i + half_i - last_i, corner_j + half_j - last_j, masses[3])
        _fuse(now, priors[h], hit, passed, masses)
        last_i, last_j = corner_i + half_i, corner_j + half_j

    posterior, prior = np.zeros((2, H, W), np.float32), np.empty((2, H, W), np.float32)
    by_hit, by_passed = np.empty((H, W), np.float32), np.empty((H, W), np.float32)
    for h in range(N - 1, -1, -1):
        corner_i, corner_j = corners[h]
        kept = np.float32(1)
        if share[h] > 0:  # what is remembered of the last frame takes its share of the forecast
            kept -= remembered * share[h] * share[h]
        shift_i, shift_j = corner_i + half_i - start[0], corner_j + half_j - start[1]
        _out_back(posterior, gradient[h], weights[h], kept, shift_i, shift_j)
        _fuse_back(by_hit, by_passed, prior, posterior, priors[h], hits[h], passes[h], masses)
        if C > 1:
            _chances_back(by_hit, by_passed, gradient[h], hits[h], passes[h], weights[h])
        by_passed *= np.float32(1) - share[h]
        stop(opaque, hits[h], clump)
        _rays_back(by_hit, by_passed, rays[h], hits[h], opaque, sensors[h, 0], sensors[h, 1], least, clump)
        k = h if len(world) > 1 else 0
        _window_back(out[k], by_hit, world[k], hits[h], corner_i - base[0], corner_j - base[1])
        if h:
            back_i, back_j = corner_i - corners[h - 1, 0], corner_j - corners[h - 1, 1]
            _age_back(posterior, prior, hits[h - 1], passes[h - 1], priors[h - 1], masses, back_i, back_j)


@njit(nogil=True, error_model="numpy", inline="always")
def _measured(a, b, q, passed, masses):  # type: ignore[no-untyped-def]
    """Expected masses of one cell after the measurement, from those before."""
    zero, one = np.float32(0), np.float32(1)
    if passed < zero:
        return combined(a, b, masses[2], zero)
    free = (one - q) * passed
    a_occupied, b_occupied = combined(a, b, masses[0], zero)
    a_free, b_free = combined(a, b, zero, masses[1])
    rest = one - q - free
    return q * a_occupied + free * a_free + rest * a, q * b_occupied + free * b_free + rest * b


@njit(nogil=True, error_model="numpy")
def _fuse(now, prior, hit, passed, masses):  # type: ignore[no-untyped-def]
    H, W = hit.shape
    for i in range(H):
        for j in range(W):
            now[0, i, j], now[1, i, j] = _measured(prior[0, i, j], prior[1, i, j], hit[i, j], passed[i, j], masses)


@njit(nogil=True)
def _out_back(posterior, gradient, weight, kept, shift_i, shift_j):  # type: ignore[no-untyped-def]
    """Gradient by the masses of what is added to the forecast; `kept` of it where the last frame is remembered."""
    C, H, W = gradient.shape
    half = np.float32(0.5)
    for i in range(H):
        for j in range(W):
            inside = 0 <= i + shift_i < H and 0 <= j + shift_j < W
            by = weight * (kept if inside else np.float32(1))
            if C == 1:
                posterior[0, i, j] += half * by * gradient[0, i, j]
                posterior[1, i, j] -= half * by * gradient[0, i, j]
            else:
                posterior[0, i, j] += by * gradient[0, i, j]
                posterior[1, i, j] += by * gradient[1, i, j]


@njit(nogil=True, error_model="numpy")
def _fuse_back(by_hit, by_passed, prior, posterior, before, hit, passed, masses):  # type: ignore[no-untyped-def]
    """Gradients by hit, transmittance and the masses before, from that by the masses after.

    With a measured mass o of occupied, Dempster's rule reads a' = (a + (1 - a - b) o) / (1 - b o), b' = b (1 - o) /
    (1 - b o), and alike for free.
    """
    zero, one = np.float32(0), np.float32(1)
    H, W = hit.shape
    for i in range(H):
        for j in range(W):
            a, b, ga, gb = before[0, i, j], before[1, i, j], posterior[0, i, j], posterior[1, i, j]
            under = passed[i, j] < zero
            q, through = (one, zero) if under else (hit[i, j], passed[i, j])
            o, f = masses[2] if under else masses[0], masses[1]
            a_occupied, b_occupied = combined(a, b, o, zero)
            a_free, b_free = combined(a, b, zero, f)
            by_hit[i, j] = by_passed[i, j] = zero
            if not under:
                by_hit[i, j] = ga * (a_occupied - through * a_free - (one - through) * a)
                by_hit[i, j] += gb * (b_occupied - through * b_free - (one - through) * b)
                by_passed[i, j] = (one - q) * (ga * (a_free - a) + gb * (b_free - b))
            free = (one - q) * through
            rest = one - q - free
            d, e = one - b * o, one - a * f
            own, other = q * (one - o), free * (one - f)
            prior[0, i, j] = ga * (own / d + other / (e * e) + rest) - gb * other * f * (one - b) / (e * e)
            prior[1, i, j] = gb * (own / (d * d) + other / e + rest) - ga * own * o * (one - a) / (d * d)


@njit(nogil=True)
def _chances_back(by_hit, by_passed, gradient, hit, passed, weight):  # type: ignore[no-untyped-def]
    """Gradient by hit and transmittance of the chances of a hit and of free that are given out."""
    H, W = hit.shape
    zero, one = np.float32(0), np.float32(1)
    for i in range(H):
        for j in range(W):
            if passed[i, j] >= zero:
                by_hit[i, j] += weight * (gradient[2, i, j] - gradient[3, i, j] * passed[i, j])
                by_passed[i, j] += weight * gradient[3, i, j] * (one - hit[i, j])


@njit(nogil=True, error_model="numpy")
def _rays_back(by_hit, by_passed, rays, hit, opaque, x, y, least, clump):  # type: ignore[no-untyped-def]
    """From the gradient by transmittance to that by hit: T of a cell falls with every cell before it on its ray.

    dT / d opaque = -T / (1 - opaque).  A cell belongs to the first of the rays that see most of it.
    """
    H, W = opaque.shape
    zero, one = np.float32(0), np.float32(1)
    taken, by_opaque = np.zeros(H * W, np.bool_), np.zeros(H * W, np.float32)
    path, through_at = np.empty(2 * (H + W), np.uint64), np.empty(2 * (H + W), np.float32)
    seen, stops, by_seen = rays.reshape(-1), opaque.reshape(-1), by_passed.reshape(-1)
    for n in range(2 * (H + W) - 4):
        target_i, target_j = border_cell(n, H, W)
        cell, steps, step_i, step_j, lead, per_i, per_j = first_cell(x, y, target_i, target_j, H, W)
        through, count = one, 0
        for _ in range(steps):
            at = np.uint64(cell)
            path[count] = at
            mine = through == seen[at] and not taken[at]
            if mine:
                taken[at] = True
            through_at[count] = through if mine else zero
            count += 1
            through *= one - stops[at]
            if through < least:
                break
            cell, lead = next_cell(cell, step_i, step_j, lead, per_i, per_j)
        behind = zero
        for k in range(count - 1, -1, -1):
            at = path[k]
            by_opaque[at] -= behind / max(one - stops[at], np.float32(1e-3))
            behind += through_at[k] * by_seen[at]
    by_stop = by_opaque.reshape(H, W)
    for i in range(H):
        for j in range(W):
            q = hit[i, j]
            some = clump + (one - clump) * q
            if some > 0:
                by_hit[i, j] += by_stop[i, j] * q * (2 * some - q * (one - clump)) / (some * some)
            else:
                by_hit[i, j] += by_stop[i, j]


@njit(nogil=True)
def _window_back(out, by_hit, world, hit, corner_i, corner_j):  # type: ignore[no-untyped-def]
    """Cells that a mover hides have no part in the gradient."""
    H, W = by_hit.shape
    for i in range(H):
        for j in range(W):
            if hit[i, j] == world[corner_i + i, corner_j + j]:
                out[corner_i + i, corner_j + j] += by_hit[i, j]


@njit(nogil=True, error_model="numpy")
def _age_back(posterior, prior, hit, passed, before, masses, shift_i, shift_j):  # type: ignore[no-untyped-def]
    """Gradient by the masses of the frame before aging; those that leave the grid have none."""
    _, H, W = posterior.shape
    one, alpha = np.float32(1), masses[3]
    posterior[:] = 0
    for i in range(max(0, -shift_i), min(H, H - shift_i)):
        for j in range(max(0, -shift_j), min(W, W - shift_j)):
            u, v = i + shift_i, j + shift_j
            a, b = _measured(before[0, u, v], before[1, u, v], hit[u, v], passed[u, v], masses)
            ga, gb = prior[0, i, j], prior[1, i, j]
            if alpha * a <= one - b:
                posterior[0, u, v] += alpha * ga
            else:
                posterior[1, u, v] -= ga
            if alpha * b <= one - a:
                posterior[1, u, v] += alpha * gb
            else:
                posterior[0, u, v] -= gb
