"""heyoka's Taylor method: motion and variations, slack/taut switches located as terminal events.

In the orbit frame or the turning one on circles, and in inertial axes beside the centre's orbit on
any orbit: there the frames, the orbit and gravity have nothing in common with the core's. The same
equations in extended precision give the references.
"""

import os

import numpy as np

from tss_ros.core.model.system import MU_EARTH

#: Radius of the equator that belongs to J2 [m], and the rate at which the Earth turns [rad/s].
EQUATOR_M, EARTH_RATE_RAD_S = 6378137.0, 7.2921159e-5


def _oblate(problem, real, away, z, square):
    """Acceleration by J2 of a bead at (away, z) from the Earth's centre."""
    s, power = problem.system, real(-2.5)
    mu = real(s.mean_motion_rad_s) ** 2 * real(s.orbit_radius_m) ** 3
    flat = real(1.5) * real(s.law_parameters["j2"]) * mu * real(EQUATOR_M) ** 2 * square**power
    tall = 5 * z * z / square
    return [flat * (tall - 1) * away[0], flat * (tall - 1) * away[1], flat * (tall - 3) * z]


def _dragged(problem, real, spin, up, position, velocity, square):
    """Acceleration by drag in air that turns with the Earth, in the frame that turns at `spin`."""
    import heyoka as hy

    s, earth = problem.system, real(EARTH_RATE_RAD_S)
    (x, y), (vx, vy, vz) = position, velocity
    rate, radius = real(s.orbit_rate_rad_s), real(s.orbit_radius_m)
    by_frame, by_orbit = rate + spin - earth, rate - earth
    wind = (vx - by_frame * y - by_orbit * up[1], vy + by_frame * x + by_orbit * up[0], vz)
    area, density, scale = (
        real(s.law_parameters[name])
        for name in ("drag_m2_per_kg", "air_density_kg_m3", "scale_height_m")
    )
    density = density * hy.exp((radius - hy.sqrt(square)) / scale)
    push = real(-0.5) * area * density * hy.sqrt(hy.sum([w * w for w in wind]))
    return [push * w for w in wind]


def _pole(problem, real):
    """Direction of the north in the axes of the orbit frame at time 0."""
    law = problem.system.law_parameters
    tilt, ahead = (
        np.deg2rad(real(sum(law[name] for name in names)))
        for names in (("inclination_deg",), ("argument_of_perigee_deg", "true_anomaly_deg"))
    )
    return -np.sin(tilt) * np.cos(ahead), np.sin(tilt) * np.sin(ahead), np.cos(tilt)


def _attraction(problem, real, place):
    """Acceleration at a place from the Earth's centre, in the axes of the orbit frame at time 0."""
    square = sum(x * x for x in place)
    round_ = -real(MU_EARTH) * square ** real(-1.5)
    flat = real(1.5) * real(problem.system.law_parameters["j2"]) * real(EQUATOR_M) ** 2 / square
    pole = _pole(problem, real)
    above = sum(x * p for x, p in zip(place, pole))
    level = 1 + flat * (1 - 5 * above * above / square)
    return [round_ * (level * x + 2 * flat * above * p) for x, p in zip(place, pole)]


def centre(problem, real):
    """Place and velocity of the centre at time 0, in the axes of the orbit frame then."""
    system, law = problem.system, problem.system.law_parameters
    e, anomaly = real(law["eccentricity"]), np.deg2rad(real(law["true_anomaly_deg"]))
    parameter = real(system.orbit_radius_m) * (1 + e)
    fast, near = np.sqrt(real(MU_EARTH) / parameter), 1 + e * np.cos(anomaly)
    zero = real(0.0)
    return [zero, parameter / near, zero], [-fast * near, fast * e * np.sin(anomaly), zero]


def _inertial(problem, real, symbols, r):
    """Accelerations of the beads beside the centre, and equations of the centre, in km.

    In km it is about as large as the formation, for heyoka's errors are relative to the largest.
    """
    place = [1000 * x for x in symbols[3:]]
    pull = _attraction(problem, real, place)
    a = [
        [g - h for g, h in zip(_attraction(problem, real, [p + q for p, q in zip(x, place)]), pull)]
        for x in r
    ]
    rates = [*(x * (1 / real(1000)) for x in pull), *symbols[:3]]
    return a, list(zip(symbols, rates))


def _between_frames(problem, real, x):
    """Axes of the orbit frame (rows) and how fast it turns, from the centre's state in km."""
    velocity, place = 1000 * x[:3], 1000 * x[3:]
    radius, momentum = np.sqrt(place @ place), np.cross(place, velocity)
    h = np.sqrt(momentum @ momentum)
    up, normal = place / radius, momentum / h
    across = np.dot(_attraction(problem, real, place), normal)
    axes = np.stack([np.cross(up, normal), up, normal])
    return axes, radius / h * across * up + h / radius**2 * normal


def _inertial_start(problem, real):
    """State of beads and centre at time 0."""
    q, v = centre(problem, real)
    x = np.concatenate([np.array(v), np.array(q)]) / 1000
    axes, turning = _between_frames(problem, real, x)
    speed, place = problem.orbit().astype(real).reshape(2, -1, 3) @ axes
    return np.concatenate([(speed + np.cross(turning, place)).ravel(), place.ravel(), x])


def _from_inertial(problem, real, x):
    """Positions and velocities in the orbit frame."""
    axes, turning = _between_frames(problem, real, x[-6:])
    v, r = x[:-6].reshape(2, -1, 3)
    found = r @ axes.T, (v - np.cross(turning, r)) @ axes.T
    return tuple(x.astype(float) for x in found)


def _turning(problem, frame, real, r, v):
    """Accelerations of the beads without tethers on a circle, in the orbit or turning frame."""
    import heyoka as hy

    system = problem.system
    rate, radius = real(system.orbit_rate_rad_s), real(system.orbit_radius_m)
    law, mean_motion = system.law_parameters, real(system.mean_motion_rad_s)
    oblate = real(1.5) * real(law["j2"]) * (real(EQUATOR_M) / radius) ** 2
    spin = real(problem.turning_rate) if frame == "turning" else real(0.0)
    up = (real(0.0), radius)
    if frame == "turning":
        up = (radius * hy.sin(spin * hy.time), radius * hy.cos(spin * hy.time))
    a = []
    for (x, y, z), (vx, vy, vz) in zip(r, v):
        away = (x + up[0], y + up[1])
        square = away[0] * away[0] + away[1] * away[1] + z * z
        gravity = mean_motion**2 * radius**3 * square ** real(-1.5)
        pull = mean_motion**2 * (1 + oblate) - gravity
        centrifugal, coriolis = spin * (spin + 2 * rate), 2 * (rate + spin)
        a.append(
            [
                pull * away[0] + centrifugal * x + coriolis * vy,
                pull * away[1] + centrifugal * y - coriolis * vx,
                -gravity * z,
            ]
        )
        more = []
        if law["j2"]:
            more.append(_oblate(problem, real, away, z, square))
        if law["drag_m2_per_kg"]:
            more.append(_dragged(problem, real, spin, up, (x, y), (vx, vy, vz), square))
        for extra in more:
            a[-1] = [p + q for p, q in zip(a[-1], extra)]
    return a


def equations(problem, frame, real):
    """Equations of motion, and the functions whose zeros are switches; `par[k]` is 1 while taut."""
    import heyoka as hy

    system, n = problem.system, problem.n
    symbol = {f"{kind}{axis}{i}": None for kind in "vr" for i in range(n) for axis in "xyz"}
    symbol = dict(zip(symbol, hy.make_vars(*symbol)))
    r = [[symbol[f"r{axis}{i}"] for axis in "xyz"] for i in range(n)]
    v = [[symbol[f"v{axis}{i}"] for axis in "xyz"] for i in range(n)]
    of_centre = []
    if frame == "inertial":
        names = hy.make_vars(*(f"{kind}{axis}" for kind in ("w", "q") for axis in "xyz"))
        a, of_centre = _inertial(problem, real, names, r)
    else:
        a = _turning(problem, frame, real, r, v)
    switches = []
    for k, (i, j) in enumerate(system.tether_ends):
        d = [p - q for p, q in zip(r[i], r[j])]
        square = hy.sum([p * p for p in d])
        inverse = square ** real(-0.5)
        closing = hy.sum([p * (q - s) for p, q, s in zip(d, v[i], v[j])])
        rest = real(system.rest_length_m[k])
        stiffness = real(system.axial_stiffness_n[k]) / rest
        damping = real(system.damping_n_s_per_m[k])
        pull = hy.par[k] * (
            stiffness - (stiffness * rest) * inverse + damping * closing * inverse * inverse
        )
        for c in range(3):
            force = pull * d[c]
            a[i][c] = a[i][c] - force * (1 / real(system.mass_kg[i]))
            a[j][c] = a[j][c] + force * (1 / real(system.mass_kg[j]))
        switches.append(square - rest * rest)
    variables = list(symbol.values())
    rates = [entry for row in (*a, *v) for entry in row]
    return [*zip(variables, rates), *of_centre], variables, switches


def _variations(problem, state):
    """Variations (6n, 6n) of the beads, a view of the state: they follow it, the centre's last."""
    size = 6 * problem.n
    begun = state.size // (1 + size)
    return state[begun : begun + size * size].reshape(size, size)


def _saltation(problem, integrator, k, became_taut):
    """Add the damping of the relative displacement along the tether to the variations.

    That is what (f+ - f-) (grad g . X) / g' comes to for Eqs. (5) and (6).
    """
    n, (i, j) = problem.n, problem.system.tether_ends[k]
    state = integrator.state
    r = state[3 * n : 6 * n].reshape(n, 3)
    x = _variations(problem, state).reshape(2, n, 3, 6 * n)
    e = r[i] - r[j]
    e = e / np.sqrt(e @ e)
    jump = (e @ (x[1, i] - x[1, j])) * problem.system.damping_n_s_per_m[k]
    jump = np.outer(e, jump if became_taut else -jump)
    x[0, i] -= jump / problem.system.mass_kg[i]
    x[0, j] += jump / problem.system.mass_kg[j]


def keep_machine_code():
    """Let heyoka keep its machine code with the environment of the benchmarks, or not at all."""
    import heyoka as hy

    if os.environ.get("BENCHMARKS_COLD"):
        hy.llvm_state.set_diskcache_enabled(False)
    elif folder := os.environ.get("BENCHMARKS_CACHE"):
        hy.llvm_state.set_diskcache_path(folder)


def _integrate(problem, tolerance, frame, real, variations, **options):
    """A function that runs the case and returns the integrator's final state."""
    import heyoka as hy

    keep_machine_code()
    system, variables, switches = equations(problem, frame, real)
    size = len(system)
    if variations:
        system = hy.var_ode_sys(system, variables, order=1)

    def toggle(k):
        def switched(integrator, direction):
            taut = real(direction > 0)
            if integrator.pars[k] != taut:  # an event may be told of twice
                integrator.pars[k] = taut
                run.switches += 1
                if variations:
                    _saltation(problem, integrator, k, direction > 0)
            return True

        return hy.t_event(switches[k], callback=switched, fp_type=real)

    integrator = hy.taylor_adaptive(
        system,
        np.zeros(size, dtype=real),
        pars=np.zeros(len(switches), dtype=real),
        tol=real(tolerance),
        fp_type=real,
        t_events=[toggle(k) for k in range(len(switches))],
        **options,
    )
    begun = np.array(integrator.state)  # with unit variations, where there are any
    starts = {
        "turning": problem.turning,
        "orbit": problem.orbit,
        "inertial": lambda: _inertial_start(problem, real),
    }

    def run():
        run.switches = 0
        integrator.reset_cooldowns()
        integrator.time = real(0.0)
        begun[:size] = starts[frame]()
        integrator.state[:] = begun
        integrator.pars[:] = problem.taut()
        outcome = integrator.propagate_until(real(problem.end_s))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise RuntimeError(f"heyoka stopped: {outcome}")
        return np.array(integrator.state)

    return run


def motion(problem, tolerance, frame="orbit", real=float, **options):
    """Run to the final positions and velocities in the orbit frame."""
    integrate = _integrate(problem, tolerance, frame, real, False, **options)
    back = {
        "turning": problem.from_turning,
        "orbit": problem.from_orbit,
        "inertial": lambda x: _from_inertial(problem, real, x),
    }

    def run():
        result = back[frame](integrate())
        run.switches = integrate.switches
        return result

    return run


def monodromy(problem, tolerance, frame="orbit", real=float, compact_mode=True, **options):
    """Run to the monodromy matrix (6n, 6n), scaled, in the turning frame."""
    integrate = _integrate(
        problem, tolerance, frame, real, True, compact_mode=compact_mode, **options
    )

    def run():
        matrix = _variations(problem, integrate())
        run.switches = integrate.switches
        return problem.scaled(matrix, frame)

    return run
