"""What a machine's springs, dampers and load are, from how it swings: `identify`.

In: a machine, and a log of a free decay of its base with the arm held. Out: an `Identification`: numbers of the machine
with their intervals of confidence, what the log leaves open, the machine with the identified numbers.
"""

from typing import TYPE_CHECKING

from flexopt.foundation.later import later

if TYPE_CHECKING:
    from flexopt.identification.identifying import identify as identify
    from flexopt.identification.result import Identification as Identification

__getattr__ = later(__name__, identifying="identify", result="Identification")
