"""The evidence: a bundle of C built on this computer, its self-test run, its numbers compared with Python.

In: a bundle's folder. Out: a `Verification`, and its report inside the folder.
"""
