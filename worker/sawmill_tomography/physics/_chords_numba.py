"""Kernel: the transmission of polygons and discs in fan-beam views, each with its own pose.

Coordinates are the hall's: the source at (0, -R), the detector's cells along (cos tau, sin tau), the body turned
by minus the view angle. An edge is crossed by the rays whose detector coordinate lies between its ends' shadows,
so the work grows with the crossings and not with the number of edges. Each ray keeps its crossings; between them the
density is constant. Grain (discs that make wood denser) and metal (discs that displace it) are added.
"""

import math

import numpy as np
from numba import njit

# Crossings of a ray that are kept; a rough board's grazing rays have some dozens.
CROSSINGS = 256


@njit(inline="always")
def _path(t, level, rise):
    """Integrate the density level + rise t from the source to t."""
    return t * (level + 0.5 * rise * t)


@njit(inline="always")
def _place(x, y, pose):
    """Return a point of the body relative to the source; pose (4,) holds the turn's cosine and sine, and the origin."""
    return pose[0] * x - pose[1] * y + pose[2], pose[1] * x + pose[0] * y + pose[3]


@njit(inline="always")
def _disc_span(x, y, radius, dx, dy):
    """Return the entry and exit of a ray from the origin along (dx, dy) in a disc; equal where the ray misses it."""
    along, aside = x * dx + y * dy, x * dy - y * dx
    square = radius * radius - aside * aside
    half = math.sqrt(square) if square > 0.0 else 0.0
    return along - half, along + half


@njit
def _sort(times, steps, count):
    """Sort by insertion: a ray has few crossings."""
    for i in range(1, count):
        t, s = times[i], steps[i]
        j = i - 1
        while j >= 0 and times[j] > t:
            times[j + 1], steps[j + 1] = times[j], steps[j]
            j -= 1
        times[j + 1], steps[j + 1] = t, s


@njit
def _overlap(times, steps, count, start, stop, level, rise):
    """Integrate the wood along a ray between start and stop."""
    total, density = 0.0, 0.0
    for i in range(count - 1):
        density += steps[i]
        low, high = max(times[i], start), min(times[i + 1], stop)
        if high > low:
            total += density * (_path(high, level, rise) - _path(low, level, rise))
    return total


@njit
def _aim(detector, first_mm, pitch_mm, directions):
    """Set unit directions (cells, 2) from the source; detector (4,): its point u = 0 from the source, and its axis."""
    for m in range(directions.shape[0]):
        u = first_mm + m * pitch_mm
        x, y = detector[0] + u * detector[2], detector[1] + u * detector[3]
        length = math.sqrt(x * x + y * y)
        directions[m, 0], directions[m, 1] = x / length, y / length


@njit
def _cross_polygon(corners, density, pose, detector, first_mm, pitch_mm, directions, times, steps, counts):
    """Record where the rays cross a polygon's edges."""
    qx, qy, ax, ay = detector
    cells = counts.size
    xa, ya = _place(corners[-1, 0], corners[-1, 1], pose)
    ua = (qy * xa - qx * ya) / (ax * ya - ay * xa)
    for v in range(corners.shape[0]):
        xb, yb = _place(corners[v, 0], corners[v, 1], pose)
        ub = (qy * xb - qx * yb) / (ax * yb - ay * xb)
        first = max(math.ceil((min(ua, ub) - first_mm) / pitch_mm), 0)
        last = min(math.ceil((max(ua, ub) - first_mm) / pitch_mm), cells)
        ex, ey = xb - xa, yb - ya
        cross = xa * ey - ya * ex
        # In a counter-clockwise polygon the edges near the source run towards larger u.
        step = density if ub > ua else -density
        for m in range(first, last):
            n = counts[m]
            if n < CROSSINGS:
                times[n, m] = cross / (directions[m, 0] * ey - directions[m, 1] * ex)
                steps[n, m] = step
            counts[m] = n + 1
        xa, ya, ua = xb, yb, ub


@njit
def _cross_disc(disc, pose, directions, times, steps, counts):
    """Record where the rays cross a disc's border."""
    x, y = _place(disc[0], disc[1], pose)
    for m in range(counts.size):
        near, far = _disc_span(x, y, disc[2], directions[m, 0], directions[m, 1])
        n = counts[m]
        if far > near:
            if n + 1 < CROSSINGS:
                times[n, m], steps[n, m] = near, disc[3]
                times[n + 1, m], steps[n + 1, m] = far, -disc[3]
            counts[m] = n + 2


@njit
def _paths(times, steps, count, grain, metal, pose, slope, dx, dy):
    """Integrate wood and metal along one ray."""
    gx, gy = pose[0] * slope[0] - pose[1] * slope[1], pose[1] * slope[0] + pose[0] * slope[1]
    level, rise = 1.0 - gx * pose[2] - gy * pose[3], gx * dx + gy * dy
    wood, steel = 0.0, 0.0
    for i in range(count):
        wood -= steps[i] * _path(times[i], level, rise)
    if grain.shape[0] == 0 and metal.shape[0] == 0:
        return wood, steel
    _sort(times, steps, count)
    for g in range(grain.shape[0] if count else 0):
        x, y = _place(grain[g, 0], grain[g, 1], pose)
        near, far = _disc_span(x, y, grain[g, 2], dx, dy)
        if far > near:
            wood += grain[g, 3] * _overlap(times, steps, count, near, far, level, rise)
    for g in range(metal.shape[0]):
        x, y = _place(metal[g, 0], metal[g, 1], pose)
        near, far = _disc_span(x, y, metal[g, 2], dx, dy)
        if far > near:
            wood -= _overlap(times, steps, count, near, far, level, rise)
            steel += metal[g, 3] * (far - near)
    return wood, steel


@njit(cache=True, nogil=True)
def transmit(
    corners, first_corners, densities, discs, grain, metal, slope,
    frame, turns, offsets, hall, samples, energies, first_mm, pitch_mm, out,
):  # fmt: skip
    """Compute the mean transmission of each cell into out (views, cells); return a ray's largest number of crossings.

    corners (corners, 2) of all polygons, counter-clockwise, polygon p from first_corners[p] on; discs, grain and metal
    (discs, 4) rows (x, y, radius, density or contrast or attenuation); slope (2,) of the density per mm from the body's
    origin; frame (R, SDD, u_c, tau); turns (views, 2) view angle and turn of the body; offsets and hall (views, 2)
    displacement in the image and in the hall; samples (samples, 3) of each cell: place in it, the source's place, both
    in mm, and angle; energies (energies, 3) share, factor of wood, factor of metal; first_mm the first cell's middle.
    """
    distance, sdd, u_c, tau = frame
    cells = out.shape[1]
    # Crossings of all rays, and of one.
    times, steps = np.empty((CROSSINGS, cells)), np.empty((CROSSINGS, cells))
    ray_times, ray_steps = np.empty(CROSSINGS), np.empty(CROSSINGS)
    counts, directions = np.empty(cells, np.int64), np.empty((cells, 2))
    pose, detector = np.empty(4), np.array([0.0, sdd - u_c * math.sin(tau), math.cos(tau), math.sin(tau)])
    most = 0
    out[:] = 0.0
    for k in range(out.shape[0]):
        for j in range(samples.shape[0]):
            first, spot = first_mm + samples[j, 0], samples[j, 1]
            view = -turns[k, 0] - samples[j, 2]
            pose[:2] = math.cos(view), math.sin(view)
            x, y = pose[0] * offsets[k, 0] - pose[1] * offsets[k, 1], pose[1] * offsets[k, 0] + pose[0] * offsets[k, 1]
            pose[0], pose[1] = math.cos(view + turns[k, 1]), math.sin(view + turns[k, 1])
            pose[2], pose[3] = x + hall[k, 0] - spot, y + hall[k, 1] + distance
            detector[0] = -u_c * detector[2] - spot
            _aim(detector, first, pitch_mm, directions)
            counts[:] = 0
            for p in range(densities.size):
                polygon = corners[first_corners[p] : first_corners[p + 1]]
                _cross_polygon(polygon, densities[p], pose, detector, first, pitch_mm, directions, times, steps, counts)
            for d in range(discs.shape[0]):
                _cross_disc(discs[d], pose, directions, times, steps, counts)
            for m in range(cells):
                count = min(counts[m], CROSSINGS)
                most = max(most, counts[m])
                if count == 0 and metal.shape[0] == 0:
                    out[k, m] += 1.0
                    continue
                for n in range(count):
                    ray_times[n], ray_steps[n] = times[n, m], steps[n, m]
                wood, steel = _paths(
                    ray_times, ray_steps, count, grain, metal, pose, slope, directions[m, 0], directions[m, 1]
                )
                for e in range(energies.shape[0]):
                    out[k, m] += energies[e, 0] * math.exp(-energies[e, 1] * wood - energies[e, 2] * steel)
    out /= samples.shape[0]
    return most
