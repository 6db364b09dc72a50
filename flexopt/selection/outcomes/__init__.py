"""Configurations, and gains, chosen by what the real loop does: by its decay, its gains, delays or soils.

In: a `SelectionProblem`, a loop, what is uncertain. Out: an `OutcomeSelection`.
"""
