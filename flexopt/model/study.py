"""A study as data: one machine, problem or experiment, what of it varies and how far, and what is computed everywhere.

In: tables. Out: frozen `Study`s, and what of them does not go with their machine. Which numbers a point has follows in
`flexopt.large_studies`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self, cast

from pydantic import Field, PrivateAttr

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Numbers
from flexopt.foundation.boundary import TABLE, instance
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import JOINT_VALUE, Quantity, list_of, numbers_in, pair, whole_number
from flexopt.model.choices import GAIN, SEED
from flexopt.model.file_model import BuiltByCall, Described
from flexopt.model.loop import Loop
from flexopt.model.machine import AnyMachine
from flexopt.model.problem import Problem
from flexopt.model.reading import load, load_experiment, load_problem
from flexopt.model.simulation import Experiment

Compute = Literal["measures", "outcome", "selection", "simulation"]
SamplingMethod = Literal["grid", "random", "sobol"]
Subject = AnyMachine | Problem | Experiment

AXES_MAX, POINTS_MAX = 24, 10**12
# A Sobol sequence of 32-bit numbers repeats itself beyond.
SOBOL_MAX = 2**30
CHUNK_MAX = 2**24
VALUE = Quantity("", low=-1e15, high=1e15)
FACTOR = Quantity("", above=0.0, high=1e3)
# What is computed, the first of each where nothing else is asked for.
QUANTITIES: dict[str, tuple[str, ...]] = {
    "measures": ("w", "w_posture", "frequency_hz", "scale", "rigid", "condition", "epsilon_max"),
    "outcome": (
        "decay", "frequency_hz", "allowed_gain", "delay_margin", "disk_margin", "h2_norm", "sensitivity_peak",
        "complementary_peak", "settling", "swing",
    ),
    "selection": ("objective", "w", "base", "posture", "epsilon_max"),
    "simulation": (
        "linear_growth_rate", "growth_rate", "growth_rate_error", "finite_until", "end_error", "overshoot",
        "settling_time", "peak_base_rotation",
    ),
}  # fmt: skip
# Those that a study has where it asks for none.
USUAL = {"measures": ("w",), "outcome": ("decay",)}
# Points of a chunk, some seconds of work at most and some 20 MB, where a study does not say.
CHUNKS = {"measures": 2**18, "outcome": 2**13, "selection": 8, "simulation": 32}
SUBJECTS: dict[str, Any] = {"machine": load, "problem": load_problem, "experiment": load_experiment}

_VALUES, _PLACEMENT = numbers_in(JOINT_VALUE), numbers_in(JOINT_VALUE, least=0)


def _check_quantity(value: Any) -> str:
    known = dict.fromkeys(name for names in QUANTITIES.values() for name in names)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"must be one of {', '.join(known)}")
    return value


_QUANTITIES = list_of("quantities", _check_quantity, "entry {}:", 1, 16)


class Vary(BuiltByCall):
    """One thing that varies in a study: an entry of its `[[vary]]`.

    Attributes:
        of: what varies: `posture.JOINT`, `base.x` (`y`, `yaw`), `target.x` (…) of a selection; `kp`, `kv`, `ki` or
            `dead_time` of a loop; `stiffness` or `damping`, all springs or dampers of the passive coordinates; a
            parameter of the machine, named as in its `parameters`, or several by `*`, which stands for any letters.
        value: (lower, upper), in its own unit, SI and radians.
        factor: (lower, upper) of one factor that multiplies what the machine has: of parameters, in place of `value`.
        count: of a grid: how many values, both ends among them.
        scale: `"linear"` or `"log"`: evenly spaced in the value, or in its logarithm; by default `"log"` of factors.

    Example:
        >>> flexopt.Vary(of="stiffness", factor=(0.5, 2.0), count=5)
        Vary(of='stiffness', factor=(0.5, 2.0), count=5)
    """

    of: Annotated[str, Field(min_length=1, max_length=200)]
    value: Annotated[tuple[float, float], pair(VALUE)] | None = None
    factor: Annotated[tuple[float, float], pair(FACTOR)] | None = None
    count: Annotated[int, whole_number(1, 10**9)] | None = None
    scale: Literal["linear", "log"] | None = None

    def structural_faults(self) -> list[Fault]:
        """What does not fit together, whatever the machine."""
        faults = list[Fault]()
        if (self.value is None) == (self.factor is None):
            faults.append(Fault("value, factor", "give one of the two, (lower, upper)"))
        if self.scale == "log" and self.value is not None and self.value[0] <= 0:
            faults.append(Fault("scale", 'is "log": the lower end must be greater than 0', str(list(self.value))))
        return faults


class Study(BuiltByCall, Described):
    """The same computation at very many points: what `flexopt.run_study` carries out (`flexopt.load_study` reads one).

    Points have numbers from 0 on. Those of a grid run through the last entry of `vary` fastest. They are computed in
    chunks; each chunk depends on the study and its own number alone, so that results do not depend on how many work.

    Attributes:
        machine: name of a shipped machine, or path of a machine file, from this file's folder.
        problem: in place of a machine, a configuration problem: of `"selection"`, whose targets must be one end-point.
        experiment: in place of a machine, an experiment: of `"simulation"`.
        compute: `"measures"` of postures, `"outcome"` of the real loop in postures, a `"selection"` or a `"simulation"`
            at every point.
        quantities: what is kept, in order. Of measures `w` (default), `w_posture` (∂w/∂posture), `frequency_hz`,
            `scale`, `rigid`, `condition`, `epsilon_max`; of an outcome `decay` (default), `frequency_hz` and the other
            numbers of `flexopt.Outcome`; of the others all by default.
        vary: what varies.
        points: `"grid"`, `"random"` (independent) or `"sobol"` (a scrambled Sobol sequence, at most 2³⁰ points).
        count: of random and Sobol points.
        seed: of these.
        chunk: points of a chunk; by default 262144 of measures, 8192 of outcomes, 8 selections, 32 simulations.
        posture: (n,), rad or m, of joints that do not vary.
        base: (n_b,), m or rad, of coordinates that do not vary; 0 by default.
        control: Jacobian `"inverse"`, `"transpose"` or `"damped:LAMBDA"`, of measures and outcomes.
        gravity: measures and outcomes under static deflection.
        gain: servo gain kr of `epsilon_max`.
        loop: of an outcome, the real controller; by default the machine's.

    Example:
        >>> study = flexopt.Study(
        ...     name="postures", machine="excavator", compute="measures",
        ...     vary=[{"of": "posture.boom", "value": (0.2, 1.2), "count": 20},
        ...           {"of": "posture.stick", "value": (-2.5, -0.5), "count": 30},
        ...           {"of": "stiffness", "factor": (0.5, 2.0), "count": 3}])
        >>> study
        Study('postures': measures of 'excavator' at 1800 points of a grid over posture.boom, posture.stick, stiffness)
    """

    machine: Annotated[str, Field(min_length=1)] | None = None
    problem: Annotated[str, Field(min_length=1)] | None = None
    experiment: Annotated[str, Field(min_length=1)] | None = None
    compute: Compute
    quantities: Annotated[tuple[str, ...], _QUANTITIES] | None = None
    vary: tuple[Vary, ...] = Field(min_length=1)
    points: SamplingMethod = "grid"
    count: Annotated[int, whole_number(1, POINTS_MAX)] | None = None
    seed: Annotated[int, SEED] = 0
    chunk: Annotated[int, whole_number(1, CHUNK_MAX)] | None = None
    posture: Annotated[Numbers, _VALUES] | None = None
    base: Annotated[Numbers, _PLACEMENT] | None = None
    control: Annotated[Control, check_control] | None = None
    gravity: bool = False
    gain: Annotated[float, GAIN] = 5e5
    loop: Loop | None = None

    _held: Subject | None = PrivateAttr(default=None)

    def __repr__(self) -> str:
        of = self.machine or self.problem or self.experiment
        over = ", ".join(each.of for each in self.vary)
        points = "a grid" if self.points == "grid" else f"a {self.points} sample"
        return f"Study({self.name!r}: {self.compute} of {of!r} at {self.total} points of {points} over {over})"

    def __str__(self) -> str:
        return repr(self)

    @property
    def total(self) -> int:
        """How many points there are."""
        return math.prod(each.count or 1 for each in self.vary) if self.points == "grid" else self.count or 0

    @property
    def chunk_points(self) -> int:
        """Points of a chunk; the last one may have fewer."""
        return self.chunk or CHUNKS[self.compute]

    @property
    def chunks(self) -> int:
        """How many chunks there are."""
        return -(-self.total // self.chunk_points)

    @property
    def kept(self) -> tuple[str, ...]:
        """The quantities, the usual ones where none are named."""
        return self.quantities or USUAL.get(self.compute, QUANTITIES[self.compute])

    def structural_faults(self) -> list[Fault]:
        """What does not fit together, whatever the machine."""
        faults = list[Fault]()
        given = [word for word in SUBJECTS if getattr(self, word) is not None]
        wanted = {"selection": "problem", "simulation": "experiment"}.get(self.compute, "machine")
        if given != [wanted]:
            sentence = f"{self.compute} needs {wanted}, a name or a path, and no other of {', '.join(SUBJECTS)}"
            faults.append(Fault(wanted, sentence, ", ".join(given) or None))
        return faults + self._name_faults() + self._count_faults() + self._kept_faults(wanted)

    def _name_faults(self) -> list[Fault]:
        """The name is that of a folder, too, wherever the study is carried out."""
        path = set("/\\:\0") & set(self.name) or self.name.strip(" .") != self.name
        sentence = "must be a name, not a path: without / \\ : and without blanks or dots at its ends"
        return [Fault("name", sentence, shown(self.name))] if path else []

    def _count_faults(self) -> list[Fault]:
        """How many points, and over what."""
        faults = list[Fault]()
        names = [each.of for each in self.vary]
        for name in sorted({name for name in names if names.count(name) > 1}):
            faults.append(Fault("vary", "varies twice", name))
        if len(names) > AXES_MAX:
            faults.append(Fault("vary", f"may have at most {AXES_MAX} entries", str(len(names))))
        for k, each in enumerate(self.vary):
            faults += [Fault(f"vary[{k}].{f.field}", f.sentence, f.value) for f in each.structural_faults()]
            if (each.count is None) == (self.points == "grid"):
                sentence = (
                    "is required in a grid" if self.points == "grid" else "goes with a grid; count is the study's"
                )
                faults.append(Fault(f"vary[{k}] ({each.of}).count", sentence))
        if (self.count is None) != (self.points == "grid"):
            sentence = "is the product of the counts of a grid" if self.points == "grid" else "is required"
            faults.append(Fault("count", f"{sentence}, with points = {self.points!r}"))
        most = SOBOL_MAX if self.points == "sobol" else POINTS_MAX
        if self.total > most:
            faults.append(Fault("count", f"a {self.points} study may have at most {most} points", str(self.total)))
        return faults

    def _kept_faults(self, wanted: str) -> list[Fault]:
        """What is not computed, and what is said elsewhere."""
        faults = list[Fault]()
        for name in self.quantities or ():
            if name not in QUANTITIES[self.compute]:
                known = ", ".join(QUANTITIES[self.compute])
                faults.append(Fault("quantities", f"{self.compute} has {known}", name))
        if self.quantities and len(set(self.quantities)) < len(self.quantities):
            faults.append(Fault("quantities", "names one twice", ", ".join(self.quantities)))
        if self.compute in ("selection", "simulation"):
            for name in ("posture", "base", "control", "loop"):
                if getattr(self, name) is not None:
                    faults.append(Fault(name, f"is the {wanted}'s to say"))
            if self.gravity:
                faults.append(Fault("gravity", f"is the {wanted}'s to say"))
        elif self.loop is not None and self.compute != "outcome":
            faults.append(Fault("loop", 'goes with compute = "outcome"'))
        return faults

    def with_subject(self, subject: Subject) -> Self:
        """The same, holding its machine, problem or experiment, in place of what its name would find.

        Example:
            >>> heavy = flexopt.load("excavator").to_dict() | {"payload": {"mass": 300.0}}
            >>> study = study.with_subject(flexopt.machine_from_dict(heavy))
            >>> study.loaded_machine.payload.mass
            300.0
        """
        kinds = {"selection": Problem, "simulation": Experiment}
        kind = kinds.get(self.compute, AnyMachine)
        if not isinstance(subject, kind):  # pyright: ignore[reportUnnecessaryIsInstance]
            sentence = f"must be a {'Machine' if kind is AnyMachine else kind.__name__} for {self.compute}"
            raise_if_any(InputError, "with_subject", [Fault("subject", sentence, shown(subject))])
        twin = self.model_copy()
        twin._held = subject
        return twin

    @property
    def subject(self) -> Subject:
        """The machine, problem or experiment: the one that it holds, else what its name finds."""
        if self._held is None:
            word = next(word for word in SUBJECTS if getattr(self, word) is not None)
            self._held = cast(Subject, SUBJECTS[word](getattr(self, word)))
        return self._held

    @property
    def loaded_machine(self) -> AnyMachine:
        """The machine that it is about."""
        subject = self.subject
        return subject if isinstance(subject, AnyMachine) else subject.loaded_machine


TABLE["study"] = instance(Study, "a Study, from flexopt.load_study for example")
