"""The article's nullspace law: the base moves uphill on V while the end-point stays put.

In: a machine and where it stands. Out: a `BaseTrajectory`.
"""
