"""Bad input and failed solves: exit code and a message that names field, value, unit and what is allowed."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.cli.command import MACHINE, PROBLEM, THIRD_LINK, Command, Patch, strict_json, toml

EVALUATE = "evaluate machine.toml --posture 1,-2"
EVALUATE_EXCAVATOR = "evaluate excavator --posture 1,-2"
SELECT = "select excavator --end-point 0,1.6"
GRAVITY = "evaluate machine.toml --posture 1,-2 --gravity"
ERROR_TYPES = {2: {"InputError", "ModelError", "UnreachableTarget", "SingularPosture"}, 3: {"NoSolutionFound"}}
FORBIDDEN = ("traceback", "casadi", "runtimeerror", "assertion", "pydantic", "input should", "errno", "datetime")


@dataclass(frozen=True)
class Row:
    id: str
    command: str
    words: tuple[str, ...]
    code: int = 2
    files: Mapping[str, str | bytes | None] = field(default_factory=dict)


def machine(id_: str, patch: Patch, *words: str, command: str = EVALUATE, code: int = 2) -> Row:
    return Row(id_, command, words, code, {"machine.toml": toml(MACHINE, patch)})


def content(id_: str, data: str | bytes | None, *words: str, command: str = EVALUATE) -> Row:
    return Row(id_, command, ("machine.toml", *words), 2, {"machine.toml": data})


def problem(id_: str, patch: Patch, *words: str, code: int = 2) -> Row:
    return Row(id_, "select problem.toml", words, code, {"problem.toml": toml(PROBLEM, patch)})


def call(id_: str, command: str, *words: str, code: int = 2) -> Row:
    return Row(id_, command, words, code)


MACHINE_ROWS = [
    machine("key-misspelt", {"base.mass": None, "base.mas": "5.0"}, "base.mas: unknown key", "'mass'"),
    machine("key-top-level-misspelt", {"bsae.mass": "5.0"}, "bsae: unknown key", "'base'"),
    machine("key-stiffness-misspelt", {"base.stifness.x": "1e7"}, "base.stifness: unknown key", "'stiffness'"),
    machine("key-direction-unknown", {"base.stiffness.z": "1e7"}, "base.stiffness.z", "x, y, rotation"),
    machine("key-name-misspelt", {"name": None, "nmae": '"digger"'}, "nmae: unknown key; did you mean 'name'"),
    machine("mass-text", {"base.mass": '"heavy"'}, "base.mass = 'heavy'", "number, not text", "kg"),
    machine("mass-bool", {"base.mass": "true"}, "base.mass", "number, not true/false", "kg"),
    machine("mass-list", {"base.mass": "[1.0]"}, "base.mass = [1.0]", "number, not a list", "kg"),
    machine("mass-table", {"base.mass": "{ kg = 1.0 }"}, "base.mass", "number, not a table", "kg"),
    machine("mass-date", {"base.mass": "1979-05-27"}, "base.mass", "1979", "number, not", "kg"),
    machine("mass-negative", {"base.mass": "-5.0"}, "base.mass = -5.0", "greater than 0", "1e+09 kg"),
    machine("mass-zero", {"links[0].mass": "0"}, "links[0] (boom).mass = 0", "greater than 0", "kg"),
    machine("mass-missing", {"links[0].mass": None}, "links[0] (boom).mass", "required"),
    machine("inertia-negative", {"base.inertia": "-1.0"}, "base.inertia = -1.0", "greater than 0", "kg m²"),
    machine("inertia-zero", {"links[1].inertia": "0.0"}, "links[1] (stick).inertia = 0.0", "greater than 0", "kg m²"),
    machine("length-zero", {"links[0].length": "0.0"}, "links[0] (boom).length = 0.0", "greater than 0", "10000 m"),
    machine("length-base-negative", {"base.length": "-0.1"}, "base.length = -0.1", "between 0 and 10000 m"),
    machine("com-far", {"base.com": "1e5"}, "base.com = 100000.0", "between -10000 and 10000 m"),
    machine("stiffness-zero", {"base.stiffness.x": "0.0"}, "base.stiffness.x = 0.0", "greater than 0", "N/m"),
    machine("stiffness-negative", {"base.stiffness.rotation": "-1.0"}, "base.stiffness.rotation = -1.0", "N m/rad"),
    machine("stiffness-one-number", {"base.stiffness": "4e7"}, "base.stiffness = 40000000.0", "table"),
    machine("damping-negative", {"base.damping.y": "-1.0"}, "base.damping.y = -1.0", "between 0 and 1e+12 N s/m"),
    machine(
        "damping-rotation-negative", {"base.damping.rotation": "-2.0"}, "base.damping.rotation = -2.0", "N m s/rad"
    ),
    machine(
        "damping-on-rigid-direction",
        {"base.stiffness.y": None, "base.damping.y": "5.0"},
        "base.damping.y",
        "base.stiffness.y",
        "rigid",
    ),
    machine("limits-reversed", {"links[0].limits": "[1.0, -1.0]"}, "(boom).limits = [1.0, -1.0]", "reversed", "rad"),
    machine("limits-one-number", {"links[0].limits": "[1.0]"}, "(boom).limits = [1.0]", "[lower, upper]", "rad"),
    machine("limits-scalar", {"links[1].limits": "2.0"}, "(stick).limits = 2.0", "[lower, upper]", "rad"),
    machine("limits-text", {"links[0].limits": '[0.0, "up"]'}, "(boom).limits", "'up'", "number, not text", "rad"),
    machine("limits-nan", {"links[0].limits": "[nan, 1.0]"}, "(boom).limits", "nan", "finite", "rad"),
    machine("rest-angle-degrees", {"base.rest_angle": "71.3"}, "base.rest_angle = 71.3", "12.5664 rad"),
    machine("nan", {"base.mass": "nan"}, "base.mass = nan", "finite", "kg"),
    machine("plus-infinity", {"base.stiffness.x": "+inf"}, "base.stiffness.x = inf", "finite", "N/m"),
    machine("minus-infinity", {"base.com": "-inf"}, "base.com = -inf", "finite", "10000 m"),
    machine("float-overflow", {"base.mass": "1e400"}, "base.mass = inf", "finite", "kg"),
    machine("integer-400-digits", {"base.mass": "1" + "0" * 400}, "base.mass = 1000", "...", "1e+09 kg"),
    machine("integer-5000-digits", {"base.mass": "1" + "0" * 5000}, "machine.toml", "digits"),
    machine("no-passive-coordinate", {"base.stiffness": None}, "base.stiffness", "no passive coordinate", "x, y or"),
    machine("stiffness-empty", {"base.stiffness": "{}"}, "base.stiffness", "no passive coordinate"),
    machine("no-links", {"links": None}, "links", "required"),
    machine("links-empty", {"links": "[]"}, "links = []", "at least one link"),
    machine("links-text", {"links": '"two"'}, "links = 'two'", "list"),
    machine("links-one-table", {"links": "{ mass = 1.0 }"}, "links", "list"),
    machine("links-of-numbers", {"links": "[1, 2]"}, "links[0] = 1", "links[1] = 2", "table"),
    machine("one-actuated-joint", {"links[1]": None}, "actuated joints) = 1", "at least two"),
    machine(
        "one-actuated-of-two",
        {"links[1].passive": "true", "links[1].stiffness": "1e6"},
        "actuated joints) = 1",
        "at least two",
    ),
    machine("passive-without-stiffness", {**THIRD_LINK, "links[2].passive": "true"}, "(bucket).stiffness", "N m/rad"),
    machine(
        "passive-with-limits",
        {**THIRD_LINK, "links[2].passive": "true", "links[2].stiffness": "1e6", "links[2].limits": "[0.0, 1.0]"},
        "(bucket).limits = [0.0, 1.0]",
        "actuated",
    ),
    machine("stiffness-on-actuated", {"links[1].stiffness": "1e6"}, "(stick).stiffness = 1000000.0", "passive = true"),
    machine("passive-text", {"links[1].passive": '"yes"'}, "(stick).passive = 'yes'", "true or false"),
    machine("schema-unknown", {"schema": "2"}, "schema = 2", "version 1"),
    machine("schema-text", {"schema": '"1"'}, "schema = '1'", "version 1"),
    machine("schema-bool", {"schema": "true"}, "schema", "version 1"),
    machine("name-missing", {"name": None}, "name", "required"),
    machine("name-empty", {"name": '""'}, "name = ''", "empty"),
    machine("name-number", {"name": "3"}, "name = 3", "text"),
    machine("link-names-equal", {"links[1].name": '"boom"'}, "links[1]", "name = 'boom'", "earlier link"),
    machine("link-name-reserved", {"links[1].name": '"payload"'}, "name = 'payload'", "reserved"),
    machine("link-name-blank", {"links[1].name": '"  "'}, "links[1]", "name = '  '", "blank"),
    machine("base-missing", {"base": None}, "base: is required"),
    machine("base-number", {"base": "3"}, "base = 3", "table"),
    machine("payload-number", {"payload": "5.0"}, "payload = 5.0", "table"),
    machine("payload-negative", {"payload.mass": "-1.0"}, "payload.mass = -1.0", "between 0 and 1e+09 kg"),
    machine("gravity-negative", {"gravity": "-9.81"}, "gravity = -9.81", "between 0 and 1000 m/s²"),
    machine(
        "five-faults-at-once",
        {
            "base.mass": "-5.0",
            "base.damping.z": "3.0",
            "links[0].length": '"long"',
            "links[1].name": '"boom"',
            "pyload.mass": "1.0",
        },
        "5 faults",
        "base.mass = -5.0",
        "base.damping.z: unknown key",
        "length = 'long'",
        "earlier link",
        "'payload'",
    ),
    content("file-empty", "", "name", "base", "links", "required"),
    content("file-syntax-error", "name = ", "TOML"),
    content("file-key-twice", 'name = "a"\nname = "b"\n', "TOML", "line 2"),
    content("file-nested-deep", "a = " + "[" * 20_000, "TOML"),
    content("file-not-utf-8", b"name = \xff\xfe", "UTF-8"),
    content("file-nul", b"\0", "TOML"),
    content("file-of-5-mb", b"#" * 5_000_000, "larger than 500 kB"),
    content("file-is-folder", None, "folder"),
    content("file-is-folder-select", None, "folder", command="select machine.toml --end-point 0,1.6"),
    call("file-missing", EVALUATE, "machine.toml", "no such file"),
    call("file-name-too-long", f"evaluate {'long' * 80}.toml --posture 1,-2", "long"),
    call("name-too-long", f"evaluate {'long' * 80} --posture 1,-2", "long", "excavator"),
    call("machine-unknown", "evaluate excavatr --posture 1,-2", "'excavatr'", "'excavator'"),
    call("machine-nothing-like-it", "evaluate zzz --posture 1,-2", "'zzz'", "excavator", "path"),
    call("machine-name-empty", "evaluate '' --posture 1,-2", "empty", "''"),
    call("machine-is-a-problem", "evaluate article --posture 1,-2", "'article'", "problem", "select"),
    Row(
        "machine-file-is-a-problem",
        "evaluate problem.toml --posture 1,-2",
        ("problem.toml", "problem", "select"),
        files={"problem.toml": toml(PROBLEM, {})},
    ),
]

PROBLEM_ROWS = [
    problem("problem-machine-unknown", {"machine": '"excavatr"'}, "'excavatr'", "'excavator'"),
    problem("problem-machine-missing", {"machine": None}, "problem.toml", "machine: is required"),
    problem("problem-machine-file-missing", {"machine": '"digger.toml"'}, "digger.toml", "no such file"),
    problem("problem-machine-number", {"machine": "3"}, "machine = 3", "text"),
    problem("problem-machine-empty", {"machine": '""'}, "machine = ''", "empty"),
    problem("problem-machine-nul", {"machine": '"a\\u0000b"'}, "a\\x00b", "unusable name"),
    problem("problem-name-missing", {"name": None}, "name", "required"),
    problem("problem-schema", {"schema": "7"}, "schema = 7", "version 1"),
    problem("target-missing", {"target": None}, "target", "required"),
    problem("target-misspelt", {"target": None, "tagret.end_point": "[0, 1]"}, "tagret: unknown key", "'target'"),
    problem("target-key-misspelt", {"target": None, "target.endpoint": "[0, 1]"}, "target.endpoint", "'end_point'"),
    problem("target-number", {"target": "3"}, "target = 3", "its keys: end_point, end_points, path"),
    problem("target-three-numbers", {"target.end_point": "[1.0, 2.0, 3.0]"}, "[1.0, 2.0, 3.0]", "two numbers", "m"),
    problem("target-text", {"target.end_point": '["a", 1.0]'}, "target.end_point", "'a'", "number, not text", "m"),
    problem("target-nan", {"target.end_point": "[nan, 1.0]"}, "target.end_point", "nan", "finite", "1e+06 m"),
    problem("target-out-of-reach", {"target.end_point": "[0, 10]"}, "(0, 10) m", "6.48", "no base position"),
    problem("objective-unknown", {"selection.objective": '"best"'}, "objective = 'best'", "w1, w2", "V"),
    problem("objective-w0", {"selection.objective": '"w0"'}, "selection.objective = 'w0'", "w1, w2", "V"),
    problem("objective-number", {"selection.objective": "1"}, "selection.objective = 1", "w1, w2", "V"),
    problem("objective-beyond-modes", {"selection.objective": '"w7"'}, "objective = 'w7'", "3 modes", "w1 to w3"),
    problem("v-without-weights", {"selection.objective": '"V"'}, "selection.weights", "objective V"),
    problem("weights-without-v", {"selection.weights": "[1, 0, 0]"}, "weights = ", "objective V", "w1"),
    problem(
        "weights-negative",
        {"selection.objective": '"V"', "selection.weights": "[-1, 0, 0]"},
        "selection.weights = [-1, 0, 0]",
        "between 0 and 1e+06",
    ),
    problem(
        "weights-zero",
        {"selection.objective": '"V"', "selection.weights": "[0, 0, 0]"},
        "selection.weights = [0, 0, 0]",
        "at least one weight must be positive",
    ),
    problem(
        "weights-too-few",
        {"selection.objective": '"V"', "selection.weights": "[1, 1]"},
        "weights = ",
        "3 modes",
        "3 weights",
    ),
    problem(
        "weights-number", {"selection.objective": '"V"', "selection.weights": "3"}, "selection.weights = 3", "a list"
    ),
    problem("margin-too-large", {"selection.singularity_margin_deg": "95.0"}, "margin_deg = 95.0", "0.01 and 80 °"),
    problem("margin-negative", {"selection.singularity_margin_deg": "-1"}, "margin_deg = -1", "0.01 and 80 °"),
    problem(
        "base-range-reversed", {"selection.base_range": "[1.0, -1.0]"}, "base_range = [1.0, -1.0]", "reversed", "m"
    ),
    problem("base-range-one", {"selection.base_range": "[1.0]"}, "base_range = [1.0]", "[lower, upper] in m"),
    problem("starts-zero", {"selection.starts": "0"}, "selection.starts = 0", "between 1 and 10000"),
    problem("starts-fraction", {"selection.starts": "2.5"}, "selection.starts = 2.5", "whole number"),
    problem("seed-negative", {"selection.seed": "-1"}, "selection.seed = -1", "whole number", "between 0 and"),
    problem("elbow-sideways", {"selection.elbow": '"sideways"'}, "selection.elbow = 'sideways'", "must be up or down"),
    problem(
        "control-unknown",
        {"selection.control": '"pid"'},
        "selection.control = 'pid'",
        "must be inverse, transpose or damped",
    ),
    problem("gravity-text", {"selection.gravity": '"yes"'}, "selection.gravity = 'yes'", "true or false"),
    problem("base-text", {"selection.base": '"here"'}, "selection.base = 'here'", "number, not text", "m"),
    problem("base-two-numbers", {"selection.base": "[1.0, 2.0]"}, "selection.base = [1.0, 2.0]", "one number", "m"),
    problem("selection-key-misspelt", {"selection.objectiv": '"w1"'}, "selection.objectiv", "'objective'"),
    problem("selection-number", {"selection": "3"}, "selection = 3", "table"),
    problem(
        "problem-four-faults",
        {"name": '""', "target.end_point": "[1]", "selection.seed": "-1", "selection.elbow": '"x"'},
        "4 faults",
        "name = ''",
        "target.end_point = [1]",
        "selection.seed = -1",
        "selection.elbow = 'x'",
    ),
    call("problem-unknown", "select articel", "'articel'", "'article'"),
    call("problem-file-missing", "select problem.toml", "problem.toml", "no such file"),
    Row(
        "problem-faults-of-its-machine",
        "select problem.toml",
        ("machine.toml", "base.mass = -5.0", "kg"),
        files={
            "problem.toml": toml(PROBLEM, {"machine": '"machine.toml"'}),
            "machine.toml": toml(MACHINE, {"base.mass": "-5.0"}),
        },
    ),
]

POSTURE_ROWS = [
    call("posture-one-angle", "evaluate excavator --posture 1", "posture = [1.0]", "2 angles", "rad", "boom, stick"),
    call("posture-three-angles", "evaluate excavator --posture 1,-2,3", "2 angles in rad", "boom, stick", "not 3"),
    call("posture-empty", "evaluate excavator --posture ''", "posture", "2 angles in rad"),
    call("posture-text", "evaluate excavator --posture a,b", "(boom) = 'a'", "(stick) = 'b'", "not text", "rad"),
    call("posture-trailing-comma", "evaluate excavator --posture 1,", "(stick) = ''", "number", "rad"),
    call("posture-nan", "evaluate excavator --posture nan,1", "(boom) = nan", "finite", "rad"),
    call("posture-infinite", "evaluate excavator --posture 1,-inf", "(stick) = -inf", "finite", "rad"),
    call("posture-degrees", "evaluate excavator --posture 57.3,-2", "(boom) = 57.3", "-12.5664 and 12.5664 rad"),
    machine(
        "posture-beyond-limits", {"links[0].limits": "[0.0, 0.5]"}, "posture (boom) = 1.0", "between 0 and 0.5 rad"
    ),
    call("posture-straight", "evaluate excavator --posture 1,0", "stick", "0 rad", "singular", "bend stick"),
    call(
        "posture-folded", "evaluate excavator --posture 1,3.141592653589793", "stick", "3.14159 rad", "180°", "singular"
    ),
    call("posture-all-but-straight", "evaluate excavator --posture 1,1e-7", "stick", "1e-07 rad", "singular"),
]

TARGET_ROWS = [
    call(
        "end-point-far",
        "evaluate excavator --end-point 5,1",
        "(5, 1) m",
        "0 m",
        "1.83",
        "0.821 to 3.015 m",
        "within reach",
    ),
    call("end-point-near", "evaluate excavator --end-point 0.2,0.6", "(0.2, 0.6) m", "0.7295 m outside", "base at"),
    call("end-point-too-high", "evaluate excavator --end-point 0,10", "(0, 10) m", "6.474 m", "no base position"),
    call("end-point-nan", "evaluate excavator --end-point nan,1", "end-point", "nan", "finite", "1e+06 m"),
    call("end-point-text", "evaluate excavator --end-point x,y", "end-point", "'x'", "number, not text", "m"),
    call("end-point-one-number", "evaluate excavator --end-point 1", "end-point = [1.0]", "two numbers", "m"),
    call("end-point-three-numbers", "evaluate excavator --end-point 1,2,3", "[1.0, 2.0, 3.0]", "two numbers"),
    call("select-end-point-beyond-any-base", "select excavator --end-point 0,10", "(0, 10) m", "no base position"),
    call("select-end-point-nan", "select excavator --end-point nan,1", "--end-point", "nan", "finite", "1e+06 m"),
    call("select-base-range-far", f"{SELECT} --base-range 50,60", "base at 50 m", "47.18 m", "-2.9738 to 2.6276 m"),
    machine(
        "end-point-limits-exclude-all",
        {"links[0].limits": "[0.0, 0.1]", "links[1].limits": "[-0.3, -0.2]"},
        "(0, 1.6) m",
        "joint limit",
        command="evaluate machine.toml --end-point 0,1.6",
    ),
    machine(
        "select-limits-exclude-all",
        {"links[0].limits": "[0.0, 0.1]", "links[1].limits": "[-0.3, -0.2]"},
        "(0, 1.6) m",
        "joint limit",
        command="select machine.toml --end-point 0,1.6",
    ),
]

OPTION_ROWS = [
    call(
        "posture-and-end-point", f"{EVALUATE_EXCAVATOR} --end-point 0,1.6", "--posture, --end-point", "one of the two"
    ),
    call("neither-posture-nor-end-point", "evaluate excavator", "--posture, --end-point", "one of the two"),
    call("elbow-with-posture", f"{EVALUATE_EXCAVATOR} --elbow down", "--elbow = down", "--end-point"),
    call("elbow-unknown", "evaluate excavator --end-point 0,1.6 --elbow left", "elbow = 'left'", "up or down"),
    call("select-elbow-unknown", f"{SELECT} --elbow left", "elbow = 'left'", "up or down"),
    call(
        "control-pid", f"{EVALUATE_EXCAVATOR} --control pid", "control = 'pid'", "inverse, transpose or damped:LAMBDA"
    ),
    call(
        "loop-control", "evaluate excavator --end-point 0,1.6 --loop control=5", "--loop control = 5.0: must be inverse"
    ),
    call("select-control-pid", f"{SELECT} --control PID", "control = 'PID'", "inverse, transpose or damped:LAMBDA"),
    call("gain-zero", f"{EVALUATE_EXCAVATOR} --gain 0", "gain = 0.0", "greater than 0"),
    call("gain-negative", f"{EVALUATE_EXCAVATOR} --gain -5e5", "gain = -500000.0", "greater than 0"),
    call("gain-text", f"{EVALUATE_EXCAVATOR} --gain high", "gain = 'high'", "number, not text"),
    call("gain-infinite", f"{EVALUATE_EXCAVATOR} --gain inf", "gain = inf", "finite"),
    call("select-gain-negative", f"{SELECT} --gain -1", "gain = -1.0", "greater than 0"),
    call("base-option-text", f"{EVALUATE_EXCAVATOR} --base here", "base", "'here'", "number, not text", "m"),
    call("base-option-empty", f"{EVALUATE_EXCAVATOR} --base ''", "base", "number, not text", "m"),
    call("base-option-two", f"{EVALUATE_EXCAVATOR} --base 1,2", "base = [1.0, 2.0]", "one number", "m"),
    call("base-option-far", f"{EVALUATE_EXCAVATOR} --base 1e9", "base", "1000000000.0", "1e+06 m"),
    call(
        "three-options-at-once",
        "evaluate excavator --posture a,1 --gain 0 --control x",
        "3 faults",
        "boom",
        "gain",
        "x",
    ),
    call("option-unknown", f"{EVALUATE_EXCAVATOR} --frobnicate", "--frobnicate"),
    call("option-misspelt", f"{EVALUATE_EXCAVATOR} --gravty", "--gravty", "--gravity"),
    call("option-without-value", "evaluate excavator --posture", "--posture", "argument"),
    call("machine-argument-missing", "evaluate --posture 1,-2", "MACHINE"),
    call("argument-too-many", f"{EVALUATE_EXCAVATOR} bucket", "bucket"),
    call("command-unknown", "evaluat excavator", "'evaluat'", "'evaluate'"),
    call("doctor-argument", "doctor excavator", "excavator"),
    call("select-without-target", "select excavator", "--end-point", "m"),
    call("plot-suffix", f"{SELECT} --plot choice.bmp", "--plot = 'choice.bmp'", ".png", ".svg", ".pdf"),
    call("plot-no-name", f"{SELECT} --plot ''", "--plot", ".png"),
    call("plot-folder-missing", f"{SELECT} --plot nowhere/choice.png", "--plot", "no folder", "'nowhere'"),
    call("plot-name-too-long", f"{SELECT} --plot {'long' * 80}.png", "--plot", "too long"),
    Row("plot-onto-folder", f"{SELECT} --plot a.png", ("--plot", "folder", "a.png"), files={"a.png": None}),
    call("out-suffix", f"{SELECT} --out choice.txt", "--out = 'choice.txt'", ".json"),
    call("out-folder-missing", f"{SELECT} --out nowhere/choice.json", "--out", "no folder", "'nowhere'"),
    call("starts-text", f"{SELECT} --starts many", "starts = 'many'", "whole number between 1 and 10000"),
    call("starts-too-many", f"{SELECT} --starts 10001", "starts = 10001", "between 1 and 10000"),
    call("starts-half", f"{SELECT} --starts 1.5", "starts = 1.5", "whole number"),
    call("seed-option-negative", f"{SELECT} --seed -1", "seed = -1", "whole number"),
    call("seed-option-huge", f"{SELECT} --seed {2**32}", f"seed = {2**32}", "between 0 and"),
    call("weights-with-w1", f"{SELECT} --weights 1,0,0", "weights = [1.0, 0.0, 0.0]", "objective V", "w1"),
    call("objective-w7", f"{SELECT} --objective w7", "objective = 'w7'", "3 modes", "w1 to w3", "V"),
    call("objective-option-unknown", f"{SELECT} --objective best", "objective = 'best'", "w1, w2", "V"),
    call("objective-v-alone", f"{SELECT} --objective V", "--weights", "is needed with objective V: 3 numbers"),
    call("weights-text", f"{SELECT} --objective V --weights 1,b,0", "weights", "'b'", "number, not text"),
    call("weights-five", f"{SELECT} --objective V --weights 1,1,1,1,1", "weights", "3 modes", "3 weights"),
    call("weights-nan", f"{SELECT} --objective V --weights nan,1,1", "weights", "nan", "finite"),
    call("base-range-option-reversed", f"{SELECT} --base-range 1,-1", "range = [1.0, -1.0]", "reversed", "m"),
    call("base-range-option-one", f"{SELECT} --base-range 1", "range = [1.0]", "[lower, upper] in m"),
    call("margin-option-90", f"{SELECT} --singularity-margin-deg 90", "margin", "90.0", "0.01 and 80 °"),
    call("margin-option-text", f"{SELECT} --singularity-margin-deg wide", "margin", "'wide'", "number", "°"),
    call("select-base-text", f"{SELECT} --base x", "base", "'x'", "number, not text", "m"),
]

PHYSICS_ROWS = [
    machine(
        "falls-over", {"base.stiffness.rotation": "1e4"}, "springs do not hold", "stiffer springs", command=GRAVITY
    ),
    machine(
        "select-falls-over",
        {"base.stiffness.rotation": "1e4"},
        "springs do not hold",
        command="select machine.toml --end-point 0,1.6 --gravity",
    ),
    machine(
        "overdamped",
        {"base.damping.rotation": "1e7"},
        "1 of 3 vibration modes",
        "overdamped",
        command=f"{EVALUATE} --damped",
    ),
    machine(
        "no-static-equilibrium",
        {"base.stiffness.rotation": "4e4"},
        "static deflection under gravity",
        "N m",
        command=GRAVITY,
        code=3,
    ),
    machine(
        "end-point-under-gravity-falls",
        {"base.stiffness.rotation": "4e4"},
        "springs do not hold",
        "stiffer springs",
        command="evaluate machine.toml --end-point 0,1.6 --gravity",
    ),
    machine("modes-unsolved", {"base.stiffness.x": "1e-300"}, "modes", "orders of magnitude", code=3),
    machine(
        "modes-unsolved-damped",
        {"base.stiffness.x": "1e-200"},
        "orders of magnitude",
        command=f"{EVALUATE} --damped",
        code=3,
    ),
    machine(
        "select-modes-unsolved",
        {"base.stiffness.rotation": "1e-200"},
        "orders of magnitude",
        command="select machine.toml --end-point 0,1.6",
        code=3,
    ),
]

ROWS = [*MACHINE_ROWS, *PROBLEM_ROWS, *POSTURE_ROWS, *TARGET_ROWS, *OPTION_ROWS, *PHYSICS_ROWS]


@pytest.mark.parametrize("row", [pytest.param(row, id=row.id) for row in ROWS])
def test_message_and_exit_code(row: Row, command: Command) -> None:
    for name, data in row.files.items():
        command.write(name, data)
    arguments = shlex.split(row.command)
    # After the command's name, because a last option without its value would take it for the value.
    plain, as_json = command(*arguments), command(arguments[0], "--json", *arguments[1:])

    assert plain.code == row.code, plain.stderr
    assert plain.stdout == ""
    assert plain.message.startswith("flexopt: ")
    check_sentence(row, plain.message)

    assert as_json.code == row.code
    assert as_json.message == plain.message
    error = as_json.document["error"]
    assert f"flexopt: {error['message']}\n" == plain.message
    assert error["type"] in ERROR_TYPES[row.code]
    assert all(fault["field"] in error["message"] for fault in error["faults"])
    assert f"({len(error['faults'])} faults)" in error["message"] or len(error["faults"]) <= 1


def check_sentence(row: Row, message: str) -> None:
    missing = [word for word in row.words if word not in message]
    assert not missing, f"{missing} not in: {message}"
    leaked = [word for word in FORBIDDEN if word in message.lower()]
    assert not leaked, f"{leaked} in: {message}"


PROCESS_ROWS = ("five-faults-at-once", "posture-straight", "modes-unsolved")


@pytest.mark.parametrize("row", [pytest.param(row, id=row.id) for row in ROWS if row.id in PROCESS_ROWS])
def test_same_from_a_shell(row: Row, tmp_path: Path) -> None:
    for name, data in row.files.items():
        assert isinstance(data, str)
        (tmp_path / name).write_text(data, encoding="utf-8")
    source = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", "from flexopt.cli import main; main()", *shlex.split(row.command), "--json"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": source, "PYTHONIOENCODING": "utf-8"},
        capture_output=True,
        encoding="utf-8",
        timeout=60,
        check=False,
    )
    assert done.returncode == row.code
    assert done.stderr.startswith("flexopt: ")
    check_sentence(row, done.stderr)
    assert strict_json(done.stdout)["error"]["message"] in done.stderr


def test_a_folder_does_not_hide_a_shipped_machine(command: Command) -> None:
    command.write("excavator", None)
    outcome = command(*shlex.split(EVALUATE_EXCAVATOR))
    assert outcome.code == 0, outcome.stderr
