"""Examinations of a bundle of C that need more than a compiler: emulated boards, sanitizers, object files, MISRA rules.

In: a `Bench`. Out: findings, whose faults a test asserts to be none. The project's own CI runs them on bundles of
shipped and random machines; `flexopt verify` runs the self-test and the comparison with Python on the user's computer.
"""
