"""Mutated files and arguments through the Python API and the command line: `python -m tests.fuzz --seconds 60`.

Every input follows from a seed and a number. A worker process judges it. A result is good, and so is a `FlexoptError`
with a sentence. A command ends with 0, 2 or 3. Everything else is a finding: another exception, a dead process, more
than 30 s, more than 2 GB. `--seed S --only K` repeats one input.
"""
