"""Robot files as spatial machines.

In: a URDF or MJCF file and the TOML file around it (its keys are told in `reading`). Out: a validated `Tree`, or one
`ModelError` that lists every fault with file, line and element.
"""

from flexopt.model.robots.reading import load_robot as load_robot
from flexopt.model.robots.reading import robot_from_dict as robot_from_dict
