"""Tables of agents that were trained inside a world model, and of policies that were ranked in it."""

from __future__ import annotations

from typing import Any

from formatting import ROOT, SUCCESS_HEAD, grid, paragraph, read, source, success

from pwm_gym.evaluation.ranking import measure_text

_LEARNED = {
    "PickCube, PPO in the model": "agent_pick_cube_ppo",
    "StackCube, PPO in the model, from starts in demonstrations": "agent_stack_cube_ppo",
    "the same with a caution of 1": "agent_stack_cube_careful",
}
_RANKED = {"PickCube": "rank_pick_cube", "StackCube": "rank_stack_cube"}


def learned() -> str:
    """Success in the simulator of agents that never saw it."""
    rows, sources = [], []
    for label, name in _LEARNED.items():
        result = read(name)
        if result is not None:
            took = result["training"]
            minutes = f"{took['seconds'] / 60:.0f} min, {took['steps'] / 1e6:.1f} M steps"
            model = f"{took['model_minutes']:.0f} min, {took['model_data_steps']:,} steps"
            rows.append([label, *success(result), minutes, model])
            sources.append(source(name, result))
    if not rows:
        return ""
    about = paragraph(
        "Policies trained by reinforcement learning inside the shipped model alone, tested in the simulator in the",
        "planners' test episodes; PPO of stable-baselines3 on entity poses ([how](train_agent.md)). The last column is",
        "the model's own training, which other tasks share, and the simulator's steps that it was trained on. Policies",
        "were trained on one thread beside other processes; PickCube's in three parts, at the beginning of each of",
        "which the learning rate rose again.",
    )
    head = [*SUCCESS_HEAD, "training of the policy", "of the model"]
    told = "\n".join(sources)
    return f"## Agents trained inside the model\n\n{told}\n{about}\n{grid(head, rows)}"


def ranked() -> str:
    """Success of policies in the model beside their success in the simulator."""
    parts = []
    for task, name in _RANKED.items():
        result = read(name)
        if result is not None:
            parts.append(_ranking(task, name, result))
    return "\n".join(parts)


def _ranking(task: str, name: str, result: dict[str, Any]) -> str:
    rows = [
        [f"`{row['name'].removeprefix('runs/')}`", *(_rate(row, world) for world in ("model", "simulator"))]
        for row in sorted(result["rows"], key=lambda row: row["simulator"])
    ]
    about = paragraph(
        f"{result['policies']} policies of {task}, {result['between_20_and_80']} of them between 20 and 80 %, each",
        f"from the same {result['scenes']} scenes in the model and in the simulator",
        f"([how](train_agent.md#rank-policies)): Pearson's r {measure_text(result['pearson'])},",
        f"Spearman's {measure_text(result['spearman'])}, MMRV {measure_text(result['mmrv'])};",
        f"{100 * result['agreement']:.0f} % of the episodes end alike.",
    )
    picture = f"![Success in the model against success in the simulator](images/{name}.png)\n"
    shown = f"\n{picture}" if (ROOT / "docs" / "images" / f"{name}.png").exists() else ""
    table = grid(["policy", "success in the model", "in the simulator"], rows)
    return f"## Ranking of policies: {task}\n\n{source(name, result)}\n{about}{shown}\n{table}"


def _rate(row: dict[str, Any], world: str) -> str:
    low, high = row[f"{world}_interval"]
    return f"{100 * row[world]:.1f} % ({100 * low:.0f} to {100 * high:.0f})"
