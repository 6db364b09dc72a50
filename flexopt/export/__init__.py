"""C for a machine's controller: a folder that compiles, refuses bad input, and carries the evidence for its numbers.

In: a machine. Out: a bundle of C (`export_c`) and, from a bundle, its verification (`verify_bundle`). The generated
code is that of the Functions that Python evaluates.
"""

from flexopt.export.bundle import ExportReport as ExportReport
from flexopt.export.bundle import export_c as export_c
from flexopt.export.parts import PARTS as PARTS
from flexopt.export.verify.verification import Verification as Verification
from flexopt.export.verify.verification import verify_bundle as verify_bundle
