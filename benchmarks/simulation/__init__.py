"""Time of closed-loop steps beside what others write: hand-written C, MuJoCo in C, Numba.

Run: python -m benchmarks.simulation
"""
