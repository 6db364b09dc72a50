"""C for a machine's controller: a folder that compiles, refuses bad input, and carries the evidence for its numbers.

In: a machine. Out: a bundle of C (`export_c`) made of `PARTS`, each a C file of functions that check their inputs and
whose kernels are the Functions that Python evaluates; and, from a bundle, its verification (`verify_bundle`).
"""

from flexopt.export.bundle import ExportReport as ExportReport
from flexopt.export.bundle import export_c as export_c
from flexopt.export.parts import PARTS as PARTS
from flexopt.export.verify.verification import Verification as Verification
from flexopt.export.verify.verification import verify_bundle as verify_bundle
