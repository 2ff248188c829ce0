import torch

from pwm_gym.dynamics.compact.attention import Block


def test_heads_mix_as_pytorchs_attention_does():
    torch.manual_seed(0)
    block, qkv = Block(32, 4, 2), torch.randn(5, 6, 96)
    q, k, v = qkv.unflatten(-1, (3, 4, 8)).permute(2, 0, 3, 1, 4)
    expected = torch.nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
    torch.testing.assert_close(block._mixed(qkv, None, None), expected)
    assert block._mixed(1e4 * qkv, None, None).isfinite().all()


def test_a_block_asked_for_some_tokens_gives_the_same():
    torch.manual_seed(0)
    block, tokens = Block(32, 4, 2), torch.randn(5, 6, 32)
    torch.testing.assert_close(block(tokens, read=4), block(tokens)[:, :4])


def test_a_token_reads_what_it_sees_alone():
    torch.manual_seed(0)
    block, tokens = Block(32, 4, 2), torch.randn(2, 6, 32)
    visible = torch.ones(2, 6, 6)
    visible[0, :3, 4] = 0.0
    torch.testing.assert_close(block(tokens, visible=torch.ones(2, 6, 6)), block(tokens))
    blind, other = block(tokens, visible=visible), tokens.clone()
    other[:, 4] = 5.0
    changed = (block(other, visible=visible) - blind).abs().amax(-1) > 1e-6
    assert changed.tolist() == [[False, False, False, True, True, True], [True] * 6]
    torch.testing.assert_close(block(tokens, read=2, visible=visible), blind[:, :2])
