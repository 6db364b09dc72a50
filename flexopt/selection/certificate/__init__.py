"""The best of a selection, proven by bounds over the whole of one degree of redundancy.

In: a selection. Out: a `Certificate`, whose log is checked by a program that shares nothing with what wrote it,
`flexopt check` or `python -m flexopt.selection.certificate.check`.
"""

from flexopt.selection.certificate.certificate import Certificate as Certificate
from flexopt.selection.certificate.certificate import certify as certify
