"""Tables of agents that were trained inside a world model, and of policies that were ranked in it."""

from __future__ import annotations

from typing import Any

from formatting import ROOT, SUCCESS_HEAD, grid, paragraph, read, section, source, success

from pwm_gym.evaluation.ranking import measure_text

_LEARNED = {
    "PickCube, PPO in the model, 256 environments": "agent_pick_cube_ppo_256",
    "1,024 environments": "agent_pick_cube_ppo",
    "PickCube, PPO in the simulator for an hour": "agent_pick_cube_ppo_sim",
    "StackCube, PPO in the model, from starts in demonstrations": "agent_stack_cube_ppo",
    "the same with a caution of 1": "agent_stack_cube_careful",
    "which goes on in a model that saw its episodes": "agent_stack_cube_further",
}
_AFTER = {"agent_stack_cube_further": "agent_stack_cube_careful"}
_FURTHER = """The last policy goes on from the careful one, in a model that was trained further on 300 episodes of that
one in the simulator, with noise on what it asks of the arm:

```
pwm-gym collect --task StackCube --episodes 250 --held-out 4 --practice 0 --randomise 0
pwm-gym collect --task StackCube --episodes 150 --held-out 1 --practice 1 --offset 3000 \\
    --out data-sets/StackCube-practice
pwm-gym collect --task StackCube --episodes 300 --held-out 1 --practice 0 --on-policy 1 \\
    --policy runs/StackCube-careful --jitter 0.3 --out data-sets/StackCube-on
pwm-gym train --data data-sets/StackCube data-sets/StackCube-practice data-sets/StackCube-on --init panda \\
    --out runs/stack --threads 1 --learning-rate 0.0015 --arm-steps 0 --error-steps 1500 \\
    --phases 1 300 256 5 400 192 15 350 128
```
"""
_GUIDED = {"PickCube": "pick_cube", "StackCube": "stack_cube"}
_RANKED = {
    "PickCube": "rank_pick_cube",
    "StackCube": "rank_stack_cube",
    "StackCube, in a model that saw the agents' episodes": "rank_stack_cube_agents",
}
_OTHERS = """PPO's agents are those above and their snapshots; the other trained ones are made by

```
{commands}
```
"""
_SEEN = """The model was trained further on 600 episodes of four of the agents in the simulator, from other seeds than
the ranking's; it goes on from the one above in which the last agent learned:

```
i=0
for policy in StackCube-ppo StackCube-ppo/snapshots/002506752 StackCube-careful StackCube-further; do
    i=$((i + 1))
    pwm-gym collect --task StackCube --episodes 150 --held-out 1 --practice 0 --on-policy 1 --policy runs/$policy \\
        --jitter 0.1 --offset $((10000 + 1000 * i)) --out data-sets/StackCube-agents/$i
done
pwm-gym train --data data-sets/StackCube data-sets/StackCube-practice data-sets/StackCube-on \\
    data-sets/StackCube-agents/{1,2,3,4} --init runs/stack/checkpoint --out runs/stack-agents --threads 1 \\
    --learning-rate 0.001 --arm-steps 0 --error-steps 0 --phases 1 200 256 5 400 192 15 350 128
```
"""
_MADE = {
    "rank_pick_cube": _OTHERS.format(
        commands="""pwm-gym collect --task PickCube --episodes 200 --held-out 4 --practice 0 --randomise 0
pwm-gym train-agent --task PickCube --threads 1 --episodes 0 --phases 1 3000 256 --out runs/PickCube-cloned
pwm-gym train-agent --task PickCube --threads 1 --episodes 0 --phases 1 1500 256 --demonstrations 20 \\
    --out runs/PickCube-cloned-20
pwm-gym train-agent --task PickCube --algo sac --agent.steps 2000000 --agent.minutes 11 --agent.discount 0.8 \\
    --agent.points 120 --agent.scenes 1000 --agent.snapshot-every 20000 --agent.threads 1 \\
    --out runs/PickCube-sac --episodes 0"""
    ),
    "rank_stack_cube": _OTHERS.format(
        commands="""pwm-gym train-agent --task StackCube --threads 1 --episodes 0 --phases 1 3000 256 \\
    --out runs/StackCube-cloned"""
    ),
    "rank_stack_cube_agents": _SEEN,
}
"""How a ranking's model or its policies were made, where nothing above on the page tells it."""


def learned() -> str:
    """Success in the simulator of agents that never saw it."""
    rows, sources = [], []
    for label, name in _LEARNED.items():
        result = read(name)
        if result is not None:
            took = result["training"]
            minutes, model = _took(took), _model_took(took)
            if (before := read(_AFTER.get(name, ""))) is not None:
                minutes += f", after {_took(before['training'])}"
                model += f", after {_model_took(before['training'])}"
            rows.append([label, *success(result), minutes, model])
            sources.append(source(name, result))
    if not rows:
        return ""
    about = paragraph(
        "Policies trained by reinforcement learning, tested in the simulator in the planners' test episodes: PPO of",
        "stable-baselines3 on entity poses ([how](train_agent.md)), inside a model alone (the shipped one but for the",
        "last) unless it says so. The last column is the model's own training, which other tasks share, and the",
        "simulator's steps that it was trained on. Each policy was trained on one thread, another process beside it.",
        "With a GPU to simulate on, ManiSkill's PPO is the faster way: PickCube in about a minute, by the notes of its",
        "[release 3.0.0b13](https://github.com/haosulab/ManiSkill/releases/tag/v3.0.0b13).",
    )
    head = [*SUCCESS_HEAD, "training of the policy", "of the model"]
    told = "\n".join(sources)
    further = f"\n{_FURTHER}" if read("agent_stack_cube_further") is not None else ""
    return f"## Agents trained inside the model\n\n{told}\n{about}\n{grid(head, rows)}{further}"


def _took(training: dict[str, Any]) -> str:
    return f"{training['seconds'] / 60:.0f} min, {training['steps'] / 1e6:.1f} M steps"


def _model_took(training: dict[str, Any]) -> str:
    if "model_minutes" not in training:
        return "none"
    return f"{training['model_minutes']:.0f} min, {training['model_data_steps']:,} steps"


def in_short() -> str:
    """What README tells of agents and rankings."""
    own, real, table = (read(name) for name in ("agent_pick_cube_ppo_256", "agent_pick_cube_ppo_sim", "rank_pick_cube"))
    if own is None or real is None or table is None:
        return ""
    rates = [row["simulator"] for row in table["rows"]]
    floor = table["floor"]
    return paragraph(
        f"An agent that learned inside the PickCube model alone (PPO, {_took(own['training'])}, one thread) solves",
        f"{own['successes']} of {own['episodes']} episodes in the simulator; the same algorithm in the simulator",
        f"itself solves {real['successes']} after {real['training']['seconds'] / 60:.0f} minutes",
        "([commands and cost](docs/results.md#agents-trained-inside-the-model)).",
        f"{table['policies']} policies, from {100 * min(rates):.0f} to {100 * max(rates):.0f} % success in the",
        f"simulator, stand in nearly the same order in the model: Pearson's r {table['pearson']['value']:.3f}, rank",
        f"violation {table['mmrv']['value']:.3f}; the simulator against itself, from other scenes,",
        f"{floor['pearson']['value']:.3f} and {floor['mmrv']['value']:.3f}",
        "([command and rates](docs/results.md#ranking-of-policies-pickcube)).",
    )


def ranked() -> str:
    """Success of policies in the model beside their success in the simulator."""
    parts = []
    for task, name in _RANKED.items():
        result = read(name)
        if result is not None:
            parts.append(_ranking(task, name, result))
    return "\n".join(parts)


def _ranking(task: str, name: str, result: dict[str, Any]) -> str:
    about = paragraph(
        f"{result['policies']} policies of {result['task']}, {result['between_20_and_80']} of them between 20 and",
        f"80 %, each from the same {result['scenes']} scenes in the model and in the simulator",
        f"([how](train_agent.md#rank-policies)): {_measures(result)}.",
    )
    if "floor" in result:
        about += "\n" + paragraph(
            "The floor, the simulator against itself from as many other scenes, which no model can be expected to",
            f"better: {_measures(result['floor'])}.",
        )
    picture = f"![Success in the model against success in the simulator](images/{name}.png)\n"
    shown = f"\n{picture}" if (ROOT / "docs" / "images" / f"{name}.png").exists() else ""
    rows = [
        [
            f"`{row['name'].removeprefix('runs/')}`",
            *(_rate(row, world) for world in ("model", "simulator")),
            _took(row["training"]) if "training" in row else "-",
        ]
        for row in sorted(result["rows"], key=lambda row: row["simulator"])
    ]
    table = grid(["policy", "success in the model", "in the simulator", "its training"], rows)
    return f"## Ranking of policies: {task}\n\n{source(name, result)}\n{about}\n{_MADE[name]}{shown}\n{table}"


def _measures(table: dict[str, Any]) -> str:
    return (
        f"Pearson's r {measure_text(table['pearson'])}, Spearman's {measure_text(table['spearman'])}, MMRV "
        f"{measure_text(table['mmrv'])}; {100 * table['agreement']:.0f} % of the episodes end alike"
    )


def _rate(row: dict[str, Any], world: str) -> str:
    low, high = row[f"{world}_interval"]
    return f"{100 * row[world]:.1f} % ({100 * low:.0f} to {100 * high:.0f})"


def guided() -> str:
    """Planning with few samples, from a policy's plans and without."""
    rows, sources = [], []
    for task, stem in _GUIDED.items():
        for start, name in {"the policy": f"guided_{stem}", "the last plan": f"unguided_{stem}"}.items():
            if (result := read(name)) is not None:
                rows.append([f"{task}, {result['settings']['samples']} samples", start, *success(result)])
                sources.append(source(name, result))
    about = paragraph(
        "MPPI in closed loop with few samples, whose plans start from what one of the policies above would do in the",
        "model, where that is cheaper than the last plan ([how](train_agent.md#a-planner-that-starts-from-a-policy)).",
    )
    head = ["planned", "plans start from", *SUCCESS_HEAD[1:]]
    return section("Planning that starts from a policy", sources, about, head, rows)
