"""Proof of an optimum by Functions that no solver used, and the last steps onto it.

In: a program and a point. Out: a `Proof`, and what it stands on: multipliers, what is active, curvature.
"""
