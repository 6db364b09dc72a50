# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Large studies
#
# Where should the arm be held on ground that may be soft or stiff, with any load? That is a question over millions of points. A *study* says
# what varies and what is computed; it is cut into chunks, and each finished chunk is a file with a checksum. Kill it, and the same call goes on.
#
# Units are SI, angles in radians.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import flexopt

folder = Path(tempfile.mkdtemp()) / "grounds"
study = flexopt.Study(
    name="grounds",
    machine="excavator",
    compute="measures",
    quantities=["w"],
    vary=[
        {"of": "posture.boom", "value": [-0.5, 1.9], "count": 61},
        {"of": "posture.stick", "value": [-2.8, -0.3], "count": 61},
        {"of": "base.stiffness.rotation", "value": [3.7e5, 3.3e6], "count": 9, "scale": "log"},
        {"of": "payload.mass", "value": [0.0, 400.0], "count": 9},
    ],
    chunk=40_000,
)
print(study.total, "points in", study.chunks, "chunks")

# %% [markdown]
# Processes of this machine by default; `executor="tcp://…"` hands the chunks to a Dask cluster.

# %%
result = flexopt.run_study(study, folder, workers=2)
print("complete:", result.complete, result.statuses)

# %% [markdown]
# ## The worst ground for each posture
#
# Reductions are streamed: no more than a chunk is in memory, however large the study is.

# %%
worst = result.reduce("w", "min", over=["base.stiffness.rotation", "payload.mass"])
worst

# %%
w1 = worst["w"].isel(mode=0).transpose("posture.stick", "posture.boom")
figure = Figure(figsize=(6.4, 4.6), layout="constrained")
axes = figure.add_subplot()
image = axes.pcolormesh(w1["posture.boom"], w1["posture.stick"], 1e6 * w1, cmap="viridis", shading="nearest")
figure.colorbar(image, label="worst $w_1$ over ground and load, 1e-6/(kg m²)")
axes.set_xlabel("boom, rad")
axes.set_ylabel("stick, rad")
figure

# %%
k = np.unravel_index(int(np.argmax(w1.to_numpy())), w1.shape)
print(
    "best of the worst:",
    float(w1[k]),
    "at boom",
    float(w1["posture.boom"][k[1]]),
    "stick",
    float(w1["posture.stick"][k[0]]),
)

# %% [markdown]
# Where this is at the edge of the grid, as it is here, there may be better beyond it: a study ranks what it was asked for, `flexopt.select`
# looks for the best.

# %% [markdown]
# ## Nothing is lost
#
# A chunk that was altered, by a disk or by hand, is found by its checksum and computed again; the others are kept.

# %%
import warnings

damaged = sorted(folder.rglob("*.nc"))[0]
damaged.write_bytes(damaged.read_bytes()[:1000])
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    again = flexopt.run_study(study, folder, workers=2)
print(*(warning.message for warning in caught if issubclass(warning.category, flexopt.FlexoptWarning)), sep="\n")
print("complete:", again.complete, " computed again:", again.mended)

# %% [markdown]
# ## Which unknown matters?
#
# Sobol indices say which share of the variance each explains, with intervals; where these overlap it is undecided.

# %%
ranges = {"base.stiffness.rotation": (3.7e5, 3.3e6), "payload.mass": (0.0, 400.0)}
found = flexopt.sensitivity(
    flexopt.load("excavator"), (0.0448, -2.0499), ranges=ranges, loop={"kp": 1e4, "kv": 1e3}, samples=256
)
found.plot()
