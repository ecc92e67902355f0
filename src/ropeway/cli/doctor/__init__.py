"""``ropeway doctor``: is this machine fit for it?"""

from __future__ import annotations

import os

import typer

from ropeway.cli.console import MARKS, answer, print_json
from ropeway.cli.session import JsonOption

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("doctor")
def doctor_command(as_json: JsonOption = False) -> None:
    """Look at this machine: versions, network, ROS and DDS settings, limits, and what a gateway can carry on it.

    Where something is amiss it says what to do.

    The exit status is 1 where something keeps Ropeway from working.
    """
    from ropeway.cli.doctor.capacity import capacity
    from ropeway.cli.doctor.machine import machine
    from ropeway.cli.doctor.robotics import robotics
    from ropeway.cli.doctor.software import software

    found = [*software(), *robotics(os.environ), *machine(), *capacity()]
    if as_json:
        print_json([symptom.to_json() for symptom in found])
    else:
        for symptom in found:
            answer(f"{MARKS[symptom.ok]}  {symptom.text}")
            if symptom.remedy:
                answer(f"      {symptom.remedy}")
    if any(symptom.ok is False for symptom in found):
        raise typer.Exit(1)
