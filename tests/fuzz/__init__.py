"""Mutated files and arguments through the Python API and the command line: `python -m tests.fuzz --seconds 60`.

Every input follows from a seed and a number. It is judged in a process of its own: good is a result, or a
`FlexoptError` with a sentence; of a command the exit codes 0, 2 and 3. Everything else is a finding: another exception,
a dead process, more than 30 s, more than 2 GB. `--seed S --only K` repeats one input.
"""
