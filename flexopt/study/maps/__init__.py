"""Maps over end-points, joints, placements, or what a controller and its machine may have; the atlas of w_i = 0.

In: a machine and ranges. Out: a `WorkspaceMap` or an `Atlas`.
"""
