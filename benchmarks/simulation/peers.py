"""The peers of the closed-loop benchmark: each builds itself once, then runs steps from any state.

In: nothing but the compiler, Numba and MuJoCo that are there; a peer whose tool is missing raises `Missing`. Out:
`run(q, v, goal, steps)` -> `Run`, the state after them and the seconds between call and return.

The work, the same for all: the excavator (models/excavator.toml; numbers folded into each program) without gravity,
q = [x, y, θ1, θ2, θ3], springs anchored at (0, 0, θ1d); RK4 at 5 ms; at the start of each step, and held over it,
τ_a = Jv(θ1d, θ2, θ3)⁻¹ (Kp (r_d − r(q)) − Kv J(q) v) with Kp = 1e5 N/m, Kv = 2e3 N s/m.
"""

from __future__ import annotations

import ctypes
import math
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import flexopt
from flexopt.compiled import find_compiler

STEP = 0.005  # s
REST = 1.2451  # rad, θ1d
POSTURE = (0.0448, -2.0499)  # rad, (θ2, θ3) of Table 2's B
OFFSET = (0.05, -0.05)  # rad, start displacement
STRICT = ("-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")  # no -ffast-math
WITHOUT_AVX512 = ("-mno-avx512f",)

_HERE = Path(__file__).parent


class Missing(Exception):
    """What the peer needs is not there; the message is the reason."""


@dataclass(frozen=True)
class Run:
    """State after the steps, q and v (5,) or (5, members), and the time they took, s."""

    q: np.ndarray
    v: np.ndarray
    seconds: float


def start(members: int | None = None, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State q (5,), v (5,) at posture B displaced by `OFFSET`, and the end-point (2,) that it has undisplaced.

    With `members`: (5, members), (5, members), (2, members), each displaced at random by up to `OFFSET`; the first as
    above.
    """
    q = np.array([0.0, 0.0, REST, POSTURE[0] + OFFSET[0], POSTURE[1] + OFFSET[1]])
    angles = np.cumsum([REST, *POSTURE])
    goal = np.array([0.541, 1.918, 1.097]) @ np.column_stack([np.cos(angles), np.sin(angles)])
    if members is None:
        return q, np.zeros(5), goal
    everyone = np.repeat(q[:, None], members, axis=1)
    spread = np.random.default_rng(seed).uniform(-1, 1, (2, members - 1))
    everyone[3:, 1:] = np.array(POSTURE)[:, None] + np.array(OFFSET)[:, None] * spread
    return everyone, np.zeros((5, members)), np.repeat(goal[:, None], members, axis=1)


class HandWritten:
    """The limit for one simulation: C by hand, closed form in absolute angles, trigonometry every 100 steps.

    It carries (cos φ, sin φ) and integrates absolute angles: equal to the others up to rounding.

    Raises:
        Missing: no compiler.
    """

    def __init__(self, flags: tuple[str, ...] = ()) -> None:
        library = _built("hand_written.c", _hand_flags() + flags)
        self._run = library.excavator_run
        self._run.argtypes = [_Doubles, _Doubles, _Doubles, ctypes.c_long]
        self._run.restype = None

    def run(self, q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> Run:
        """`steps` steps from (q, v)."""
        return _timed(lambda q, v, goal: self._run(q, v, goal, steps), q, v, goal)


class HandWrittenLanes:
    """The limit for many: the same by hand, a member in each lane of a vector and two vectors in turn.

    Attributes:
        together: members advanced at once; a number of members that it does not divide wastes lanes.

    Raises:
        Missing: no compiler.
    """

    def __init__(self, flags: tuple[str, ...] = (), threads: int = 1) -> None:
        library = _built("hand_written_lanes.c", (*_hand_flags(), *_wide(), *flags))
        self._run = library.excavator_run_lanes
        self._run.argtypes = [_Doubles, _Doubles, _Doubles, *[ctypes.c_long] * 4]
        self._run.restype = None
        self.together: int = library.excavator_lanes()
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads)

    def run(self, q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> Run:
        """`steps` steps of each column of (q, v); the members are dealt to the threads in equal parts."""
        n = q.shape[1]
        part = self.together * math.ceil(n / (self.together * self.threads))
        parts = [(first, min(first + part, n)) for first in range(0, n, part)]

        def all_of_them(q: Any, v: Any, goal: Any) -> None:
            if len(parts) == 1:
                self._run(q, v, goal, 0, n, n, steps)
            else:
                list(self._pool.map(lambda ends: self._run(q, v, goal, *ends, n, steps), parts))

        return _timed(all_of_them, q, v, goal)


class MujocoLoop:
    """MuJoCo, all C: `mj_step` with RK4 in a loop linked against the library in its wheel, the controller in C.

    The model comes from the machine file (tests/oracles/mujoco_chain.py); whatever this machine has not (contacts,
    constraints, sensors …) is switched off. Forces act through `qfrc_applied`, set once before each step.

    Raises:
        Missing: no MuJoCo, no compiler, or no library that can be linked.
    """

    def __init__(self) -> None:
        try:
            mujoco: Any = import_module("mujoco")  # an optional peer

            from tests.oracles.mujoco_chain import mujoco_chain  # noqa: PLC0415
        except ImportError as error:
            raise Missing(f"no MuJoCo ({error})") from error
        folder = Path(mujoco.__file__).parent
        shared = sorted([*folder.glob("libmujoco*.so*"), *folder.glob("libmujoco*.dylib")])
        if not shared:
            raise Missing("the MuJoCo package has no library to link")
        link = ("-x", "none", str(shared[0]), f"-Wl,-rpath,{folder}")
        library = _built("mujoco_loop.c", (*STRICT, f"-I{folder / 'include'}"), link)
        self._run = library.excavator_run
        self._run.argtypes = [ctypes.c_void_p, _Doubles, _Doubles, _Doubles, ctypes.c_long]
        self._run.restype = None
        library.excavator_load.restype = ctypes.c_void_p
        library.excavator_load.argtypes = [ctypes.c_char_p]
        model = mujoco_chain(flexopt.load("excavator").model_dump(by_alias=True), 0.0).model
        model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
        model.opt.gravity[:] = 0.0
        kept = {"mjDSBL_SPRING", "mjDSBL_DAMPER"}
        for name, bit in mujoco.mjtDisableBit.__members__.items():
            if name.startswith("mjDSBL_") and name not in kept:
                model.opt.disableflags |= bit.value
        file = _folder() / "excavator.mjb"
        mujoco.mj_saveModel(model, str(file), None)
        self._simulation = library.excavator_load(str(file).encode())
        if not self._simulation:
            raise Missing("MuJoCo cannot read its own model file")

    def run(self, q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> Run:
        """`steps` steps from (q, v)."""
        return _timed(lambda q, v, goal: self._run(self._simulation, q, v, goal, steps), q, v, goal)


class NumbaLoop:
    """Numba: the closed form with sin and cos at each stage, strict arithmetic, one compiled loop.

    Raises:
        Missing: no Numba.
    """

    def __init__(self) -> None:
        try:
            from benchmarks.simulation import numba_loop  # noqa: PLC0415 - an optional peer
        except ImportError as error:
            raise Missing(f"no Numba ({error})") from error
        self._run: Callable[..., None] = numba_loop.run
        self.run(*start(), 1)  # compiled before it is timed

    def run(self, q: np.ndarray, v: np.ndarray, goal: np.ndarray, steps: int) -> Run:
        """`steps` steps from (q, v)."""
        q, v = np.array(q), np.array(v)
        begun = time.perf_counter()
        self._run(q, v, goal, steps)
        return Run(q, v, time.perf_counter() - begun)


def worst_difference(a: Run, b: Run) -> float:
    """Largest |difference| of any coordinate or rate, SI."""
    return float(max(np.abs(a.q - b.q).max(), np.abs(a.v - b.v).max()))


def flags() -> str:
    """How the hand-written programs are compiled, beside -march=native."""
    return " ".join((*_hand_flags(), *_wide()))


_Doubles = ctypes.POINTER(ctypes.c_double)


def _timed(call: Callable[[Any, Any, Any], object], q: np.ndarray, v: np.ndarray, goal: np.ndarray) -> Run:
    """Call with pointers to copies of q and v, which it changes, and to the goal."""
    copies = [np.array(a, dtype=np.float64, order="C") for a in (q, v, goal)]
    pointers = [a.ctypes.data_as(_Doubles) for a in copies]
    begun = time.perf_counter()
    call(*pointers)
    seconds = time.perf_counter() - begun
    return Run(copies[0], copies[1], seconds)


def _hand_flags() -> tuple[str, ...]:
    """Pairs are formed in the source; the tuning of gcc for the newest processors spills more registers."""
    compiler = find_compiler()
    zig = compiler is not None and "ziglang" in compiler.command  # has no -mtune
    return (*STRICT, "-fno-tree-slp-vectorize", *(("-mtune=generic",) if _is_x86() and not zig else ()))


def _wide() -> tuple[str, ...]:
    return ("-mprefer-vector-width=512",) if _is_x86() else ()


def _is_x86() -> bool:
    return platform.machine().lower() in {"x86_64", "amd64"}


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="flexopt-peers-", ignore_cleanup_errors=True)


def _folder() -> Path:
    return Path(_temporary().name)


def _built(source: str, flags: tuple[str, ...], link: tuple[str, ...] = ()) -> ctypes.CDLL:
    """`source` as a loaded library; -march=native (or what the compiler calls it) comes before `flags`."""
    compiler = find_compiler()
    if compiler is None:
        raise Missing("no C compiler")
    if "ziglang" in compiler.command and set(WITHOUT_AVX512) & set(flags):
        raise Missing(f"zig ignores {' '.join(WITHOUT_AVX512)}")
    with tempfile.NamedTemporaryFile(dir=_folder(), suffix=".so", delete=False) as file:
        library = file.name
    command = [*compiler.command, "-std=gnu11", "-shared", "-fPIC", "-fvisibility=hidden", *compiler.target, *flags,
               "-o", library, "-x", "c", str(_HERE / source), *link, "-lm"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Missing(f"{source} does not compile: {(done.stderr.strip().splitlines() or ['no message'])[0]}")
    return ctypes.CDLL(library)
