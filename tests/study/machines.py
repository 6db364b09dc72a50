"""Machines of the map tests."""

import flexopt


def three_links():
    """The excavator with a bucket: a redundant arm."""
    data = flexopt.load("excavator").to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0}
    return flexopt.machine_from_dict(data | {"links": [*data["links"], bucket]})


def limited():
    """The excavator with joint limits that shut out part of its reach."""
    data = flexopt.load("excavator").to_dict()
    limits = ([-0.5, 1.5], [-2.5, -0.5])
    boom, stick = ({**link, "limits": pair} for link, pair in zip(data["links"], limits, strict=True))
    return flexopt.machine_from_dict(data | {"links": [boom, stick]})
