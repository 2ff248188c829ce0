"""The section on OGBench's cube by the protocol of figures that others publish."""

from __future__ import annotations

from typing import Any

from formatting import grid, number, paragraph, read, source

from pwm_gym.evaluation.planning import wilson

_NAME, _STARTS = "plan_ogbench_cube_single_play", "play_starts"
_COMPLETED = f"{_NAME}_completed"
_EPISODES = 50
_OTHERS = {"DINO-WM": 86, "goal-conditioned behaviour cloning": 84, "LeWM": 74, "PLDM": 65, "TD-MPC2": 4}
"""Success in percent that stable-worldmodel's ``docs/baselines.md`` reports for "OGB Cube"."""


def published() -> str:
    """Success from starts in play, and what differs from the published protocol."""
    result, starts, completed = read(_NAME), read(_STARTS), read(_COMPLETED)
    if result is None:
        return ""
    table = grid(["episodes", "successes", "95 % interval", "mean steps of successes"], _rows(result, completed))
    others = ", ".join(f"{name} {figure}" for name, figure in _OTHERS.items())
    about = paragraph(
        "stable-worldmodel reports figures of image world models on OGBench's cube. Its protocol, as `cube.yaml` and",
        "`World.evaluate` of its commit addbab4 have it: a start is any state of its data set `cube_single_expert`",
        "with 25 more steps behind it in its episode, positions and velocities; the goal is the picture of the state",
        "25 steps later, and a success the first step of 50 that ends with the cube within 4 cm of its place there.",
        "`--starts play` has the same rules.",
    )
    fewer = "" if result["episodes"] + result["at_reset"] >= _EPISODES else f", and fewer than its {_EPISODES}"
    differs = paragraph(
        "What differs: planners here get complete clouds, or what the shipped network completes of one depth image,",
        "joint angles and the place that the cube shall go to, where those get a picture of the present and one of the",
        "goal, which shows where the arm is to be, too. Episodes are played anew from their seeds by the recipe of its",
        "script that collects such data (OGBench's",
        f"`CubeMarkovOracle`, noise, 200 steps), not read from that file{fewer}. MPPI plans anew at",
        "every step here, there CEM does every 25 steps. The world model was trained on demonstrations and practice",
        f"from other starts. What they report, percent: {others}.",
    )
    results = {_NAME: result, _COMPLETED: completed, _STARTS: starts}
    told = "\n".join(source(name, each) for name, each in results.items() if each is not None)
    parts = [f"## OGBench's cube, the protocol of published figures\n\n{told}", about, table, _easy(starts), differs]
    return "\n".join(part for part in parts if part)


def _rows(result: dict[str, Any], completed: dict[str, Any] | None) -> list[list[str]]:
    """Counted as those figures are, and without the episodes in which nothing has to be done."""
    rows = []
    for clouds, each in (("complete clouds", result), ("one camera's completed clouds", completed)):
        if each is not None:
            given, wins, episodes = each["at_reset"], each["successes"], each["episodes"]
            steps = each["mean_steps_of_successes"]
            rows += [
                _row(f"{clouds}, all episodes, as the published figures count", wins + given, episodes + given, None),
                _row(f"{clouds}, those alone whose cube has to move by more than 4 cm", wins, episodes, steps),
            ]
    return rows


def _row(name: str, wins: int, episodes: int, steps: float | None) -> list[str]:
    low, high = wilson(wins, episodes)
    return [name, f"{wins} / {episodes}", f"{low:.0%} to {high:.0%}", number(steps, 0)]


def _easy(starts: dict[str, Any] | None) -> str:
    """How much such starts leave to do."""
    if starts is None:
        return ""
    way = starts["way_m"]
    return paragraph(
        f"Of {starts['episodes']} such starts {starts['solved']:.0%} are solved before the first action; in the others",
        f"the cube moves by more than 4 cm until its goal. {starts['solved_idle']:.0%} are solved within",
        f"{starts['steps']} steps in which nothing is asked of the robot, in {starts['held']:.0%} the gripper holds",
        f"the cube. Its way to the goal is {100 * way['50']:.0f} cm in the median, {100 * way['90']:.0f} cm or more in",
        "a tenth.",
    )
