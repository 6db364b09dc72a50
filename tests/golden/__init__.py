"""Golden numbers: every public call on every shipped machine and problem, against numbers that are kept.

`calls.py` says what is called, `kept/` what came out, `tolerances.py` how far apart the two may be, and why.
`python -m tests.golden` prints what differs; `--write` keeps new numbers. `differences.md` lists intended differences.
"""
