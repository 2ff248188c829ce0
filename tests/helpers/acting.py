"""What tests of the compact model share: acting in synthetic scenes, and comparing what came of it."""

from dataclasses import replace

import torch

EVERY = [
    "cube", "drawer", "lid", "four", "unknown arm", "two arms", "pot", "bolted hand", "no arm", "one thing"
]  # fmt: skip


def steps(model, state, actions):
    """States after each of the actions (T, B, A)."""
    state, found = model.prepare(state), []
    for action in actions:
        state = model.step(state, action)
        found.append(state)
    return found


def many_actions(world, count, batch=2):
    return torch.stack([world.actions(batch, seed=k) for k in range(count)])


def at_rest(world, count, batch=2):
    return torch.zeros(count, batch, world.control.size)


def moved(a, b, *names):
    """Largest difference of the poses of entities called so (all, if none is given) in two states."""
    places = [a.layout.index(n) for n in names] or slice(None)
    return float((a.poses() - b.poses())[:, places].abs().max())


def on(state, parent, child):
    """Pose (B, 4, 4) of one entity in another's frame."""
    names = state.layout.index
    return torch.linalg.inv(state.poses()[:, names(parent)]) @ state.poses()[:, names(child)]


def reordered(state, order):
    """The same scenes with their entities in the order of ``order``, places in the old layout."""
    old = state.layout
    entities = [old.entities[k] for k in order]
    layout = replace(old, entities=()).plus(entities)
    return replace(
        state, layout=layout, clouds=torch.cat([state.clouds[:, e.slice] for e in entities], 1),
        frames=state.frames[:, :, order],
    )  # fmt: skip
