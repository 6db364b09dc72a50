"""What completion offers on flexopt's objects: what users ask of them, nothing of how they are made."""

from __future__ import annotations

# What flexopt's own classes ask of each other.
PLUMBING = frozenset({
    "DOCUMENT", "LOADER", "build_tree", "document", "document_keys", "model_post_init", "parameter_entries",
    "part_faults", "shortly", "structural_faults",
})  # fmt: skip
