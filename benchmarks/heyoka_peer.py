"""heyoka's Taylor method: motion and variations, slack/taut switches located as terminal events.

The same equations in extended precision give the references.
"""

import os

import numpy as np

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


def equations(problem, frame, real):
    """Equations of motion, and the functions whose zeros are switches; `par[k]` is 1 while taut."""
    import heyoka as hy

    system, n = problem.system, problem.n
    symbol = {f"{kind}{axis}{i}": None for kind in "vr" for i in range(n) for axis in "xyz"}
    symbol = dict(zip(symbol, hy.make_vars(*symbol)))
    r = [[symbol[f"r{axis}{i}"] for axis in "xyz"] for i in range(n)]
    v = [[symbol[f"v{axis}{i}"] for axis in "xyz"] for i in range(n)]
    rate, radius = real(system.orbit_rate_rad_s), real(system.orbit_radius_m)
    law, mean_motion = system.law_parameters, real(system.mean_motion_rad_s)
    oblate = real(1.5) * real(law["j2"]) * (real(EQUATOR_M) / radius) ** 2
    spin = real(problem.spin) if frame == "turning" else real(0.0)
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
    return list(zip(variables, rates)), variables, switches


def _saltation(problem, integrator, k, became_taut):
    """Add the damping of the relative displacement along the tether to the variations.

    That is what (f+ - f-) (grad g . X) / g' comes to for Eqs. (5) and (6).
    """
    n, (i, j) = problem.n, problem.system.tether_ends[k]
    state = integrator.state
    r = state[3 * n : 6 * n].reshape(n, 3)
    x = state[6 * n :].reshape(2, n, 3, 6 * n)
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

    size = 6 * problem.n
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

    def run():
        run.switches = 0
        integrator.reset_cooldowns()
        integrator.time = real(0.0)
        begun[:size] = problem.turning() if frame == "turning" else problem.orbit()
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
    back = problem.from_turning if frame == "turning" else problem.from_orbit

    def run():
        result = back(integrate())
        run.switches = integrate.switches
        return result

    return run


def monodromy(problem, tolerance, frame="orbit", real=float, compact_mode=True, **options):
    """Run to the monodromy matrix (6n, 6n), scaled, in the turning frame."""
    integrate = _integrate(
        problem, tolerance, frame, real, True, compact_mode=compact_mode, **options
    )

    def run():
        matrix = integrate()[6 * problem.n :].reshape(6 * problem.n, -1)
        run.switches = integrate.switches
        return problem.scaled(matrix, frame)

    return run
