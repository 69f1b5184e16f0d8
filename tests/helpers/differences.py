"""Derivatives and variations, held to differences."""

import numpy as np


def differences(function, x, step):
    """Central differences of the fourth order, (outputs, inputs)."""
    columns = []
    for k in range(x.size):
        h = np.zeros(x.size)
        h[k] = step
        h = h.reshape(x.shape)
        near, far = function(x + h) - function(x - h), function(x + 2 * h) - function(x - 2 * h)
        columns.append((8.0 * near - far).ravel() / (12.0 * step))
    return np.stack(columns, 1)


def assert_variations_are_differences(integrator, state, end, size, rtol, switches=0):
    """Of all displacements, column by column, in units of the motion's largest.

    All motions have so many slack/taut switches.
    """
    system = integrator.system
    half, settings = 3 * system.n, integrator.settings
    scale = np.repeat([settings.speed, settings.length], half)
    columns = (np.eye(2 * half) * scale).reshape(2, system.n, 3, 2 * half)
    motion = integrator.begin(state).with_variations(*columns)
    integrator.advance(motion, end)
    assert motion.switches == switches
    matrix = np.concatenate([motion.x_v, motion.x_r]).reshape(2 * half, -1) / scale[:, None]

    def flow(x):
        other = integrator.begin(state)
        other.v[:] += (x[:half] * scale[:half]).reshape(-1, 3)
        other.r[:] += (x[half:] * scale[half:]).reshape(-1, 3)
        integrator.advance(other, end)
        assert other.switches == switches
        change = np.concatenate([(other.v - motion.v).ravel(), (other.r - motion.r).ravel()])
        return change / scale

    expected = differences(flow, np.zeros(2 * half), size)
    np.testing.assert_allclose(matrix, expected, rtol=0.0, atol=rtol * np.abs(expected).max())
    return matrix
