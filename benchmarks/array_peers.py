"""Solvers that differentiate the equations themselves: diffrax (JAX) and CVODES through CasADi.

Both in the turning frame, in units of the radius and the rim speed, tethers switched by length.
"""

import functools

import numpy as np


def _equations(problem, to, time, x):
    """Derivative of the scaled state (6n,): velocities, then positions.

    `to` holds what differs between the libraries: sqrt, sin, cos, where, and how to stack.
    """
    s, n, spin = problem.system, problem.n, problem.spin
    rate, speed, length = s.orbit_rate_rad_s, problem.speed, problem.radius
    rho = s.orbit_radius_m / length
    up = (to["sin"](spin * time), to["cos"](spin * time))
    v = [[x[3 * i + c] for c in range(3)] for i in range(n)]
    r = [[x[3 * (n + i) + c] for c in range(3)] for i in range(n)]
    turn, coriolis = spin * (spin + 2.0 * rate), 2.0 * (rate + spin)
    a = []
    for p, q in zip(r, v):
        along = p[0] * up[0] + p[1] * up[1]
        u = (2.0 * along + (p[0] ** 2 + p[1] ** 2 + p[2] ** 2) / rho) / rho
        w = (1.0 + u) * to["sqrt"](1.0 + u)
        f = rate**2 * u * (3.0 + u * (3.0 + u)) / (w * (1.0 + w))
        unit = length / speed
        a.append(
            [
                unit * (f * (p[0] + rho * up[0]) + turn * p[0]) + coriolis * q[1],
                unit * (f * (p[1] + rho * up[1]) + turn * p[1]) - coriolis * q[0],
                unit * (f - rate**2) * p[2],
            ]
        )
    for k, (i, j) in enumerate(s.tether_ends):
        d = [g - h for g, h in zip(r[i], r[j])]
        w = [g - h for g, h in zip(v[i], v[j])]
        size = to["sqrt"](d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
        growth = (d[0] * w[0] + d[1] * w[1] + d[2] * w[2]) / size
        rest = s.rest_length_m[k] / length
        pull = s.axial_stiffness_n[k] * (size / rest - 1.0) / speed
        pull = to["where"](size > rest, pull + s.damping_n_s_per_m[k] * growth, 0.0) / size
        for c in range(3):
            a[i][c] = a[i][c] - pull * d[c] / s.mass_kg[i]
            a[j][c] = a[j][c] + pull * d[c] / s.mass_kg[j]
    positions = [(speed / length) * entry for row in v for entry in row]
    return to["stack"]([entry for row in a for entry in row] + positions)


@functools.cache
def _diffrax(problem, method, variations):
    """A function of the tolerance, compiled by JAX once for all of them."""
    import diffrax
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp

    to = {"sin": jnp.sin, "cos": jnp.cos, "sqrt": jnp.sqrt, "where": jnp.where, "stack": jnp.stack}
    size = 6 * problem.n
    begun = jnp.asarray(problem.turning() / problem.units())

    def derivative(t, x, _):
        return _equations(problem, to, t, x)

    def with_variations(t, x, _):
        def along(direction):
            return jax.jvp(lambda y: _equations(problem, to, t, y), (x[0],), (direction,))[1]

        return derivative(t, x[0], None), jax.vmap(along)(x[1])

    terms = diffrax.ODETerm(with_variations if variations else derivative)
    start = (begun, jnp.eye(size)) if variations else begun

    @jax.jit
    def solve(x, tolerance):
        solution = diffrax.diffeqsolve(
            terms,
            getattr(diffrax, method)(),
            0.0,
            problem.end_s,
            1.0,
            x,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            max_steps=10_000_000,
            throw=False,
            saveat=diffrax.SaveAt(t1=True),
            adjoint=diffrax.ForwardMode(),
        )
        return solution.ys, solution.result == diffrax.RESULTS.successful

    def run(tolerance):
        ys, successful = jax.block_until_ready(solve(start, tolerance))
        if not successful:
            raise RuntimeError("diffrax did not reach the end")
        return ys

    return run


def diffrax_motion(problem, tolerance, method):
    """diffrax, compiled by JAX before the clock starts."""
    solve = _diffrax(problem, method, False)
    return lambda: problem.from_turning(np.asarray(solve(tolerance))[0] * problem.units())


def diffrax_monodromy(problem, tolerance, method):
    """The same with the variational equations beside; no saltation."""
    solve = _diffrax(problem, method, True)
    return lambda: np.asarray(solve(tolerance)[1])[0].T


def _casadi(problem, tolerance):
    import casadi as ca

    to = {
        "sin": ca.sin,
        "cos": ca.cos,
        "sqrt": ca.sqrt,
        "where": ca.if_else,
        "stack": lambda parts: ca.vertcat(*parts),
    }
    x, t = ca.SX.sym("x", 6 * problem.n), ca.SX.sym("t")
    equations = {"x": x, "t": t, "ode": _equations(problem, to, t, x)}
    options = {"abstol": tolerance, "reltol": tolerance, "max_num_steps": 10_000_000}
    return ca.integrator("turn", "cvodes", equations, 0.0, problem.end_s, options)


def casadi_motion(problem, tolerance):
    """CVODES by CasADi."""
    integrator, start = _casadi(problem, tolerance), problem.turning() / problem.units()

    def run():
        end = integrator(x0=start)["xf"]
        return problem.from_turning(np.asarray(end).ravel() * problem.units())

    return run


def casadi_monodromy(problem, tolerance):
    """CVODES by CasADi with forward sensitivities; no saltation."""
    integrator = _casadi(problem, tolerance)
    sensitivity = integrator.factory("sensitivity", ["x0"], ["jac:xf:x0"])
    start = problem.turning() / problem.units()
    return lambda: np.asarray(sensitivity(start))
