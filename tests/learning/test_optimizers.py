import copy

import pytest
import torch
from torch import nn

from pwm_gym.learning import build_optimizer
from pwm_gym.learning.optimizers import Muon, orthogonalised


def network():
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(7, 48), nn.GELU(), nn.Linear(48, 64), nn.GELU(), nn.Linear(64, 3))


def train(model, optimizer, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        inputs = torch.randn(32, 7, generator=generator)
        optimizer.zero_grad()
        loss = (model(inputs) - inputs[:, :3].sin()).square().mean()
        loss.backward()
        optimizer.step()
    return float(loss.detach())


@pytest.mark.parametrize("muon", [False, True])
def test_learns(muon):
    model = network()
    optimizer = build_optimizer(model, 3e-3, 0.01, muon)
    before = train(model, optimizer, 1)
    assert train(model, optimizer, 200) < 0.1 * before


def test_muon_turns_hidden_matrices_and_adamw_all_else():
    models = [network(), network()]
    for muon, model in enumerate(models):
        train(model, build_optimizer(model, 1e-3, 0.0, bool(muon)), 1)
    same = [torch.equal(a, b) for a, b in zip(*(model.parameters() for model in models), strict=True)]
    assert same == [True, True, False, True, True, True]
    hidden = models[1][2].weight
    update, gradient = hidden - network()[2].weight, hidden.grad
    strongest = [float(x[:8].sum() / x.sum()) for x in map(torch.linalg.svdvals, (update.detach(), gradient))]
    assert strongest[0] < 0.5 * strongest[1]


@pytest.mark.parametrize("muon", [False, True])
def test_resumes_from_its_state(muon):
    model = network()
    optimizer = build_optimizer(model, 1e-3, 0.01, muon)
    train(model, optimizer, 3)
    again = copy.deepcopy(model)
    resumed = build_optimizer(again, 1e-3, 0.01, muon)
    resumed.load_state_dict(copy.deepcopy(optimizer.state_dict()))
    train(model, optimizer, 3, seed=1)
    train(again, resumed, 3, seed=1)
    for a, b in zip(model.parameters(), again.parameters(), strict=True):
        assert torch.equal(a, b)


def test_sets_the_learning_rate_of_all_parameters():
    model = network()
    optimizer = build_optimizer(model, 1e-3, 0.01, muon=True)
    before = copy.deepcopy(model)
    optimizer.set_learning_rate(0.0)
    train(model, optimizer, 2)
    for a, b in zip(model.parameters(), before.parameters(), strict=True):
        assert torch.equal(a, b)


def test_muon_is_pytorchs_without_its_rounding():
    torch.manual_seed(0)
    start = torch.randn(48, 96)
    ours, theirs = nn.Parameter(start.clone()), nn.Parameter(start.clone())
    one = Muon([ours], 3e-3, 0.01)
    other = torch.optim.Muon([theirs], 3e-3, 0.01, adjust_lr_fn="match_rms_adamw")
    for _ in range(5):
        ours.grad = torch.randn(48, 96)
        theirs.grad = ours.grad.clone()
        one.step()
        other.step()
    moved = (ours - start).detach().abs().max()
    assert (ours - theirs).detach().abs().max() < 0.03 * moved


@pytest.mark.parametrize("shape", [(40, 64), (64, 40)])
def test_orthogonalised_matrices_have_singular_values_near_one(shape):
    values = torch.linalg.svdvals(orthogonalised(torch.randn(shape, generator=torch.Generator().manual_seed(0))))
    assert float(values.min()) > 0.5 and float(values.max()) < 1.5
