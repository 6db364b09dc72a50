"""Wording: what each command prints, every number masked, one snapshot file a command.

`python -m tests.wording --write` renews the snapshots; tests of numbers are elsewhere (`tests/golden`).
"""
