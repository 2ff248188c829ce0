import json
from dataclasses import asdict

import pytest
import torch
import torch.nn.functional as F

from pwm_gym.dynamics.paper.ptv3.layers import DropPath, GridPool, PatchAttention, PositionConv
from pwm_gym.dynamics.paper.ptv3.level import Level
from pwm_gym.dynamics.paper.ptv3.network import PointTransformer, PTv3Config
from pwm_gym.dynamics.paper.ptv3.serialization import CURVES, encode, hilbert, merge_duplicates, z_order
from pwm_gym.errors import PwmGymError

TINY = PTv3Config(
    encoder_depths=(1, 1, 1),
    encoder_channels=(8, 16, 16),
    encoder_heads=(2, 2, 2),
    encoder_patches=(32, 12, 16),
    decoder_depths=(1, 1),
    decoder_channels=(8, 16),
    decoder_heads=(2, 2),
    decoder_patches=(32, 12),
    mlp_ratio=2,
)


@pytest.fixture
def rng():
    return torch.Generator().manual_seed(0)


def cube_cells(depth):
    side = torch.arange(2**depth)
    return torch.cartesian_prod(side, side, side)


def level_of(grid, counts, depth=5):
    """Level of given cells (T, 3); the first ``counts[0]`` are of scene 0, and so on."""
    counts = torch.tensor(counts)
    batch = torch.repeat_interleave(torch.arange(len(counts)), counts)
    return Level(grid, batch, counts, encode(grid, tuple(CURVES), depth), depth)


def random_level(rng, counts, depth=5, distinct=True):
    parts = []
    for n in counts:
        if distinct:
            parts.append(cube_cells(3)[torch.randperm(512, generator=rng)[:n]])
        else:
            parts.append(torch.randint(0, 4, (n, 3), generator=rng))
    return level_of(torch.cat(parts), counts, depth)


# Serialisation


def z_reference(x, y, z, depth):
    code = 0
    for bit in reversed(range(depth)):
        for value in (x, y, z):
            code = code << 1 | (value >> bit & 1)
    return code


def test_z_order_matches_a_bitwise_reference(rng):
    grid = torch.randint(0, 2**16, (200, 3), generator=rng)
    expected = [z_reference(*row, 16) for row in grid.tolist()]
    assert z_order(grid, 16).tolist() == expected


@pytest.mark.parametrize("depth", [1, 2, 3, 4])
def test_hilbert_visits_every_cell_once_and_moves_to_a_neighbour(depth):
    grid = cube_cells(depth)
    codes = hilbert(grid, depth)
    order = codes.argsort()
    assert codes[order].tolist() == list(range(8**depth))
    assert ((grid[order][1:] - grid[order][:-1]).abs().sum(-1) == 1).all()


@pytest.mark.parametrize("name", CURVES)
def test_code_prefix_identifies_the_parent_cell(name):
    grid = cube_cells(3)
    parent = z_order(grid >> 1, 2)
    pairs = torch.unique(torch.stack([encode(grid, [name], 3)[0] >> 3, parent], 1), dim=0)
    assert len(pairs) == 64


def test_transposed_curves_exchange_x_and_y(rng):
    grid = torch.randint(0, 2**12, (3, 50, 3), generator=rng)
    z, zt, h, ht = encode(grid, ("z", "z-trans", "hilbert", "hilbert-trans"), 12)
    assert z.shape == (3, 50) and z.dtype == torch.int64
    swapped = grid[..., [1, 0, 2]]
    assert torch.equal(zt, z_order(swapped, 12)) and torch.equal(ht, hilbert(swapped, 12))
    assert not torch.equal(h, ht)


def test_unknown_curve_lists_the_known():
    with pytest.raises(PwmGymError, match="hilbert"):
        encode(torch.zeros(1, 3, dtype=torch.int64), ["hilbrt"], 4)
    with pytest.raises(PwmGymError, match="z-trans"):
        PTv3Config(curves=("z-tran",))


def test_merge_duplicates_depends_on_the_set_of_rows_only(rng):
    rows = torch.randint(0, 3, (2, 60, 3), generator=rng).float()  # many repeats
    token, place = merge_duplicates(rows)
    flat = rows.flatten(0, 1)
    assert torch.equal(flat[token][place], flat)
    assert torch.equal(token // 60, (token // 60).sort().values)
    assert len(token) == sum(len(torch.unique(r, dim=0)) for r in rows)
    shuffled = rows[:, torch.randperm(60, generator=rng)]
    other, _ = merge_duplicates(shuffled)
    assert torch.equal(shuffled.flatten(0, 1)[other], flat[token])


def test_points_of_one_cell_are_ordered_by_their_coordinates(rng):
    points = torch.rand(1, 40, 3, generator=rng) * 0.003  # one cell of 4 mm
    orders = []
    for p in (points, points[:, torch.randperm(40, generator=rng)]):
        token, _ = merge_duplicates(p)
        level = Level.build(p[0, token], torch.zeros_like(token), 1, 0.004, tuple(CURVES), 12)
        orders.append(p[0, token][level.order(2)])
    assert torch.equal(*orders)


# Levels


@pytest.mark.parametrize("counts", [(1,), (16,), (17, 1, 40), (3, 5), (32, 16, 64)])
@pytest.mark.parametrize("curve", range(4))
def test_patches_hold_every_token_once_and_one_scene_each(rng, counts, curve):
    level = random_level(rng, counts)
    patches = level.patches(curve, 16)
    assert torch.equal(patches.tokens.flatten()[patches.place], torch.arange(sum(counts)))
    scenes = level.batch[patches.tokens]
    assert (scenes == scenes[:, :1]).all()
    assert len(scenes) == sum(-(-n // 16) for n in counts)
    if patches.valid is not None:
        assert patches.valid.flatten()[patches.place].all()
        for tokens, valid in zip(patches.tokens, patches.valid, strict=True):
            assert len(tokens[valid].unique()) == valid.sum()
    assert (patches.valid is None) == (min(counts) >= min(16, max(counts)))


def test_patches_follow_the_curve(rng):
    level = random_level(rng, (40, 30))
    codes = level.codes[2][level.patches(2, 10).tokens]
    assert (codes[:, 1:] > codes[:, :-1]).all()


def test_pool_halves_the_grid(rng):
    level = random_level(rng, (100, 7), distinct=False)
    coarse, parent = level.pool()
    assert torch.equal(coarse.grid[parent], level.grid >> 1)
    assert torch.equal(coarse.batch[parent], level.batch)
    assert coarse.sizes == [len(torch.unique(level.grid[level.batch == b] >> 1, dim=0)) for b in (0, 1)]
    assert torch.equal(coarse.codes[:, parent], level.codes >> 3)
    assert (coarse.batch.diff() >= 0).all()


def test_grid_pool_takes_the_largest(rng):
    level = random_level(rng, (60, 9), distinct=False)
    coarse, parent = level.pool()
    pool = GridPool(4, 6)
    x = torch.randn(69, 4, generator=rng)
    got = pool(x, parent, len(coarse.batch))
    for i in range(len(coarse.batch)):
        largest = pool.linear(x[parent == i]).amax(0)
        torch.testing.assert_close(got[i], F.gelu(pool.norm(largest)))


def test_points_beyond_the_grid_stay_on_its_border():
    points = torch.tensor([[0.0, 0.0, 0.0], [1e9, -1e9, float("nan")], [float("inf"), 0.0, 0.0]])
    level = Level.build(points, torch.zeros(3, dtype=torch.int64), 1, 0.004, tuple(CURVES), 12)
    assert level.grid.min() >= 0 and level.grid.max() == 4095
    assert level.grid[1, :2].tolist() == [4095, 0]


# Layers


def dense_conv(conv, grid, x, side):
    volume = torch.zeros(1, x.shape[1], side, side, side)
    volume[0, :, grid[:, 0], grid[:, 1], grid[:, 2]] = x.T
    weight = conv.weight.unflatten(0, (3, 3, 3)).permute(4, 3, 0, 1, 2)
    return F.conv3d(volume, weight, padding=1)[0, :, grid[:, 0], grid[:, 1], grid[:, 2]].T


def test_convolution_matches_a_dense_one(rng):
    counts = (150, 60)  # of 512 cells of a grid that they fill to its borders
    level = random_level(rng, counts, depth=3)
    conv = PositionConv(5)
    x = torch.randn(210, 5, generator=rng)
    parts = zip(level.grid.split(counts), x.split(counts), strict=True)
    expected = torch.cat([dense_conv(conv, g, f, 8) for g, f in parts])
    torch.testing.assert_close(conv.convolve(x, level), expected, atol=1e-5, rtol=1e-5)
    assert conv(x, level).shape == x.shape


def test_convolution_averages_tokens_of_one_cell(rng):
    single = random_level(rng, (30,))
    twice = level_of(torch.cat([single.grid, single.grid]), (60,))
    conv = PositionConv(4)
    a, b = torch.randn(2, 30, 4, generator=rng)
    got = conv.convolve(torch.cat([a, b]), twice)
    expected = conv.convolve((a + b) / 2, single)
    torch.testing.assert_close(got, torch.cat([expected, expected]), atol=1e-5, rtol=1e-5)


def naive_attention(layer, x, grid):
    q, k, v = layer.qkv(x).chunk(3, -1)
    out = torch.zeros_like(x)
    width = x.shape[1] // layer.heads
    for h in range(layer.heads):
        part = slice(h * width, (h + 1) * width)
        for i in range(len(x)):
            logits = k[:, part] @ q[i, part] / width**0.5
            if layer.relative is not None:
                reach = layer.relative.reach
                for j in range(len(x)):
                    apart = (grid[i] - grid[j]).clamp(-reach, reach) + reach
                    logits[j] = logits[j] + sum(layer.relative.table[a, apart[a], h] for a in range(3))
            out[i, part] = logits.softmax(0) @ v[:, part]
    return layer.out(out)


@pytest.mark.parametrize("reach", [None, 3])
@torch.no_grad()
def test_attention_matches_a_naive_one(rng, reach):
    counts = (20, 9)  # the second scene does not fill the patch
    level = random_level(rng, counts)
    layer = PatchAttention(8, 2, 48, reach, True)
    if layer.relative is not None:
        layer.relative.table.normal_(generator=rng)
    x = torch.randn(29, 8, generator=rng)
    parts = zip(x.split(counts), level.grid.split(counts), strict=True)
    expected = torch.cat([naive_attention(layer, f, g) for f, g in parts])
    torch.testing.assert_close(layer(x, level, 1), expected, atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_attention_stays_in_the_patch(rng):
    level = random_level(rng, (20,))
    layer = PatchAttention(8, 2, 10, None, True)
    x = torch.randn(20, 8, generator=rng)
    first, last = level.order(0).split(10)
    changed = x.clone()
    changed[last] += 1
    difference = (layer(x, level, 0) - layer(changed, level, 0)).abs().amax(-1)
    assert (difference[first] == 0).all() and (difference[last] > 0).all()


def test_drop_path_drops_whole_scenes_in_training_only(rng):
    level = random_level(rng, (3,) * 200)
    drop = DropPath(0.3)
    x = torch.ones(600, 2)
    scenes = drop(x, level).view(200, -1)
    assert (scenes == scenes[:, :1]).all()
    torch.testing.assert_close(scenes[:, 0].unique(), torch.tensor([0.0, 1 / 0.7]))
    assert 0.15 < (scenes[:, 0] == 0).float().mean() < 0.45
    assert torch.equal(drop.eval()(x, level), x)


# Network


def run(network, points, features):
    """Network's output (B, N, C) for points (B, N, 3) in metres and features (B, N, F)."""
    rows = torch.cat([points, features], -1)
    token, place = merge_duplicates(rows)
    batch = token // points.shape[1]
    level = network.level(points.flatten(0, 1)[token], batch, len(points), 0.01)
    return network(level, rows.flatten(0, 1)[token])[place].unflatten(0, points.shape[:2])


def cloud(rng, scenes=3, count=150):
    return torch.rand(scenes, count, 3, generator=rng) * 0.15, torch.randn(scenes, count, 2, generator=rng)


@pytest.fixture
def network():
    torch.manual_seed(0)
    return PointTransformer(5, TINY).eval()


@torch.no_grad()
def test_network_is_deterministic_and_leaves_the_global_generator_alone(network, rng):
    data = cloud(rng)
    before = torch.get_rng_state()
    a, b = run(network, *data), run(network, *data)
    assert a.shape == (3, 150, 8)
    assert torch.equal(a, b)
    assert torch.equal(before, torch.get_rng_state())


@torch.no_grad()
def test_permuted_points_give_permuted_outputs(network, rng):
    points, features = cloud(rng)
    points[:, 100:] = points[:, :50]  # the same place, another feature
    features[:, 120:] = features[:, 20:50]  # the same row
    order = torch.randperm(150, generator=rng)
    a, b = run(network, points, features), run(network, points[:, order], features[:, order])
    torch.testing.assert_close(a[:, order], b, atol=1e-5, rtol=0)
    assert torch.equal(a[:, 120:], a[:, 20:50])


@torch.no_grad()
def test_scenes_do_not_see_each_other(network, rng):
    points, features = cloud(rng)
    points[1] *= 0.2  # far fewer cells than the others
    together = run(network, points, features)
    alone = torch.cat([run(network, points[[b]], features[[b]]) for b in range(3)])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=0)


def test_curves_are_shuffled_in_training_only(network, rng):
    points, features = cloud(rng, 1)
    batch = torch.zeros(150, dtype=torch.int64)
    level = network.level(points[0], batch, 1, 0.01)
    x = torch.cat([points, features], -1)[0]
    assert torch.equal(network.encode(level, x).levels[0].codes, level.codes)
    network.train()
    firsts = {network.encode(level, x).levels[0].codes[0, :5].numpy().tobytes() for _ in range(30)}
    assert len(firsts) > 2
    torch.manual_seed(7)
    a = network(level, x)
    torch.manual_seed(7)
    assert torch.equal(a, network(level, x))


def test_successive_blocks_take_successive_curves():
    network = PointTransformer(9)
    blocks = [b for stage in (*network.encoder, *network.decoder) for b in stage]
    assert [b.curve for b in blocks] == list(range(10))
    assert [b.attention.relative is not None for b in blocks] == [False, False, True, True] * 2 + [False] * 2
    assert [b.position is None for b in blocks] == [b.attention.relative is not None for b in blocks]
    assert [b.attention.patch for b in blocks] == [256, 256, 48, 48] * 2 + [256] * 2
    rates = [b.drop.rate for b in blocks]
    assert rates[0] == 0 and max(rates) == rates[5] == rates[6] == pytest.approx(0.3) and rates[9] == 0


def test_config_survives_json_and_names_bad_values():
    assert PTv3Config(**json.loads(json.dumps(asdict(TINY)))) == TINY
    with pytest.raises(PwmGymError, match="encoder_heads"):
        PTv3Config(encoder_heads=(8, 8))
    with pytest.raises(PwmGymError, match="30"):
        PTv3Config(encoder_channels=(30, 128, 256))
    with pytest.raises(PwmGymError, match="cpe"):
        PTv3Config(decoder_positions=("cpe", "rp"))
