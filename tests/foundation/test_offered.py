"""What completes in a notebook: IPython's own completer, on tables, machines and results."""

from __future__ import annotations

import inspect
from typing import Any

import jedi
import pytest
from IPython.core.completer import Completer
from pydantic import BaseModel

import flexopt
from docs.public import methods
from flexopt.foundation.offered import PLUMBING

PYDANTIC = {name for name in dir(BaseModel) if not name.startswith("_")}
MODELS = [
    name for name in flexopt.__all__ if inspect.isclass(kind := getattr(flexopt, name)) and issubclass(kind, BaseModel)
]


def offered(namespace: dict[str, Any], text: str) -> set[str]:
    completer = Completer(namespace=namespace)
    completer.use_jedi = False
    return {match.removeprefix(text) for match in completer.attr_matches(text)}


@pytest.mark.parametrize("name", MODELS)
def test_classes_offer_their_keys_and_nothing_of_pydantic(name: str) -> None:
    kind = getattr(flexopt, name)
    found = offered({"flexopt": flexopt}, f"flexopt.{name}.")
    own = {key for key in kind.__dict__ if key in PYDANTIC and not key.startswith("model_")}
    assert found & (PYDANTIC | PLUMBING) <= own
    assert set(kind.model_fields) <= found
    assert {of.rpartition(".")[2] for of, _ in methods(kind)} - PYDANTIC <= found


@pytest.mark.parametrize("made", [flexopt.Loop(kp=1e4), flexopt.Sensor(), flexopt.SelectionOptions()], ids=repr)
def test_tables_offer_their_keys(made: BaseModel) -> None:
    assert offered({"made": made}, "made.") >= set(type(made).model_fields)
    assert not offered({"made": made}, "made.") & (PYDANTIC | PLUMBING)


def test_results_offer_what_users_ask_of_them() -> None:
    machine = flexopt.load("excavator")
    found = flexopt.evaluate(machine, (0.9929, -2.6306))
    listed = offered({"found": found, "machine": machine}, "found.")
    assert listed >= {"w", "frequencies_hz", "posture", "to_dict"}
    assert not listed & PLUMBING
    assert offered({"machine": machine}, "machine.") >= {"joints", "parameters", "to_dict", "loop"}
    assert not offered({"machine": machine}, "machine.") & (PYDANTIC | PLUMBING)


def test_the_package_offers_its_public_names_and_its_rooms() -> None:
    found = {name for name in offered({"flexopt": flexopt}, "flexopt.") if not name.startswith("_")}
    assert set(flexopt.__all__) <= found
    rooms = found - set(flexopt.__all__)
    assert {"plant", "selection", "simulation"} <= rooms
    assert all(inspect.ismodule(getattr(flexopt, name)) for name in rooms)


@pytest.mark.parametrize("made", ["simulate", "simulate_ensemble", "evaluate", "outcome"])
def test_results_complete_by_jedi_too(made: str) -> None:
    """It reads annotations, as IPython asks it to where it is there; one that it cannot read ends it."""
    machine, held = flexopt.load("excavator"), (0.9929, -2.6306)
    more: dict[str, Any] = {"simulate": {"duration": 0.1}, "outcome": {"loop": {"kp": 1e4}}}.get(made, {})
    if made == "simulate_ensemble":
        more = {"duration": 0.1, "vary": {"base.mass": [900.0]}}
    result = getattr(flexopt, made)(machine, held, **more)
    found = {each.name for each in jedi.Interpreter("result.", [{"result": result}]).complete()}
    assert {name for name in dir(type(result)) if not name.startswith("_")} <= found
