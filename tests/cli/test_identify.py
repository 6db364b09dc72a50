"""`flexopt identify`, and `flexopt select` with a log."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.cli.analysis import of_the_log
from tests.cli.command import Command

# How the excavator of the article swings where its ground is 1.5 times as stiff as its file says, in one mode.
POSTURE = "0.5,-1.2"


def write_log(command: Command) -> None:
    t, rng = np.arange(400) / 100, np.random.default_rng(1)
    swing = 0.02 * np.exp(-0.2 * t) * np.cos(14.4 * t) + 1e-5 * rng.standard_normal(t.size)
    lines = [f"{1e3 * a:g},{np.degrees(b):.8g}" for a, b in zip(t, swing, strict=True)]
    command.write("swing.csv", "t [ms],gyro_z [deg/s]\n" + "\n".join(lines) + "\n")


@pytest.mark.long
def test_the_command_says_what_python_says(command: Command) -> None:
    write_log(command)
    words = ("identify", "excavator", "swing.csv", "--posture", POSTURE, "--unknown", "base.*.rotation")
    document = command.json(*words, "--plot", "swing.png", "--out", "found.json")
    found = flexopt.identify(flexopt.load("excavator"), "swing.csv", posture=[0.5, -1.2], unknown="base.*.rotation")
    assert document["values"] == found.to_dict()["values"]
    assert document["intervals"]["base.stiffness.rotation"] == list(found.intervals["base.stiffness.rotation"] or ())
    assert document["machine_sha256"] == found.machine.content_hash
    assert set(document["values"]) == {"base.stiffness.rotation", "base.damping.rotation"}
    assert repr(found) in command(*words).stdout
    more = command.json(*words[:-2], "--unknown", "base.stiffness.rotation", "--unknown", "base.damping.rotation")
    assert set(more["values"]) == set(document["values"])


@pytest.mark.long
def test_a_selection_with_a_log_is_one_of_the_identified_machine(command: Command) -> None:
    write_log(command)
    words = ("--end-point", "0,1.6", "--base", "0", "--posture", POSTURE, "--starts", "1")
    document = command.json("select", "excavator", *words, "--log", "swing.csv", "--imu", "0.3,0.1")
    found = document["identification"]
    assert document["provenance"]["machine_sha256"] == found["machine_sha256"]
    assert found["machine_sha256"] != flexopt.load("excavator").content_hash
    assert found["posture"] == [0.5, -1.2]
    # It knows where the log's accelerometer sits.
    assert found["provenance"]["options"]["imu"] == [0.3, 0.1]


def test_what_a_log_told_is_called_the_logs(command: Command) -> None:
    """No number of an identified machine is the file's, in text and document."""
    uncertain = {"stiffness": (0.5, 2.2)}
    machine = flexopt.load("excavator")
    judged: dict[str, Any] = {"loop": {"kp": 1e4, "kv": 1e3}, "members": 2, "runs": 0, "starts": 1}
    for ranges in (uncertain, None):
        found = flexopt.verdict(machine, (0.0, 1.6), base=0.0, ranges=ranges, **judged)
        text, document = of_the_log(repr(found)), json.dumps(of_the_log(found.to_dict()))
        assert "decay with the log's numbers" in text
        assert ("is as the log and the machine's file have it" in text) == (ranges is None)
        assert not any(told in each for each in (text, document) for told in ("the file's", "numbers of the file"))
    write_log(command)
    words = ("--end-point", "0,1.6", "--base", "0", "--posture", POSTURE, "--starts", "1")
    told = command("select", "excavator", *words, "--log", "swing.csv").stdout
    assert "the machine has these numbers now, which factors of ranges multiply: the log's, in what follows" in told


def test_the_command_refuses(command: Command) -> None:
    write_log(command)
    for words, sentence in (
        (("identify", "excavator", "swing.csv"), "posture: is needed"),
        (("identify", "excavator", "nothing.csv", "--posture", POSTURE), "cannot be read"),
        (("identify", "excavator", "swing.csv", "--posture", "a,b"), "--posture (boom)"),
        (("identify", "excavator", "swing.csv", "--posture", POSTURE, "--unknown", "stifness"), "did you mean"),
        (("identify", "excavator", "swing.csv", "--posture", POSTURE, "--window", "3"), "--window"),
        (("select", "excavator", "--end-point", "0,1.6", "--log", "swing.csv"), "posture: is needed"),
        (("select", "article", "--certify", "--log", "proof.json"), "--proof writes what"),
        (("select", "article", "--proof", "proof.json"), "goes with --certify"),
        (("select", "article", "--imu", "0.3,0.1"), "--imu goes with --log"),
        (("select", "article", "--log", "swing.csv", "--posture", POSTURE, "--imu", "0.3"), "--imu = [0.3]"),
    ):
        refused = command(*words)
        assert refused.code == 2
        assert sentence in refused.stderr


def test_what_is_wrong_with_a_log_is_one_sentence(command: Command) -> None:
    command.write("swing.csv", "t,gyro_z\n" + "\n".join(f"{k / 100},{k % 2}" for k in range(20)) + "\n")
    said = command("identify", "excavator", "swing.csv", "--posture", POSTURE).stderr
    assert said.startswith("flexopt: identify: the log is too short: 20 samples")
