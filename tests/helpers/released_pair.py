"""A pair of satellites released with velocities of its own, as a scenario file."""

SCENARIO = """
description: two satellites released with velocities of their own
spin_rate_ratio: -3.0
bodies:
  - {name: a, mass_kg: 100.0, position_m: [0.0, 500.0, 0.0], velocity_m_s: [1.6212, 0.0, 0.0]}
  - {name: b, mass_kg: 100.0, position_m: [0.0, -500.0, 0.0], velocity_m_s: [-1.6212, 0.0, 0.0]}
tethers:
  - {between: [a, b], length_m: 1000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 500.0}
"""
