"""All robust postures of a machine over two of its joints.

In: a plane of postures. Out: an `Atlas`: the curves w_i = 0, where two of them meet and where they end, singular
postures, and the edges of the workspace; of machines in space the points w_i = 0.
"""

from flexopt.robustness.atlas.fields import ROWS as ROWS
from flexopt.robustness.atlas.fields import Slice as Slice
from flexopt.robustness.atlas.rectangle import Rectangle as Rectangle
from flexopt.robustness.atlas.result import Atlas as Atlas
from flexopt.robustness.atlas.result import EdgeCurve as EdgeCurve
from flexopt.robustness.atlas.result import RobustCurve as RobustCurve
from flexopt.robustness.atlas.result import RobustPoint as RobustPoint
from flexopt.robustness.atlas.survey import survey as survey
