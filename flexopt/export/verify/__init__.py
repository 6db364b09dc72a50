"""The evidence: what a bundle of C does, compared with Python and examined by compilers, sanitizers and emulators.

In: a bundle's folder. Out: a `Verification`, and its report inside the folder.
"""
