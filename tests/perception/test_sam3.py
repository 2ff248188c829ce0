"""SAM3's own loading and running code on a tiny model with random weights, offline."""

import importlib.util
import json
import os
import shutil
import string
import sys
import types

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from safetensors.torch import load_file, save_file

from pwm_gym.cameras import DepthCamera
from pwm_gym.errors import PwmGymError
from pwm_gym.perception import Frame, HeightGate, Sam3Segmenter, Segmenter, sam3
from pwm_gym.perception.sam3 import _prepare

CAMERA = DepthCamera.looking((0.6, 0.0, 0.5), (0.0, 0.0, 0.0), width=64, height=48)
PROMPTS = {"cube": "red cube", "mug": "a blue mug"}


@pytest.fixture(autouse=True)
def offline(monkeypatch, tmp_path):
    import huggingface_hub.constants

    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path / "no-cache"))


def _tiny_config(vocabulary: int):
    from transformers import Sam3Config

    part = {"hidden_size": 32, "intermediate_size": 32, "num_attention_heads": 4, "num_layers": 1}
    vit = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2}
    vit |= {"image_size": 56, "pretrain_image_size": 28, "window_size": 2, "global_attn_indexes": [0]}
    text = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2}
    text |= {"vocab_size": vocabulary, "bos_token_id": vocabulary - 2, "eos_token_id": vocabulary - 1}
    sizes = [[16, 16], [8, 8], [4, 4]]
    return Sam3Config(
        vision_config={
            "fpn_hidden_size": 32,
            "backbone_feature_sizes": sizes,
            "backbone_config": {"model_type": "sam3_vit_model", **vit},
        },
        text_config={"model_type": "clip_text_model", "projection_dim": 16, "max_position_embeddings": 32, **text},
        geometry_encoder_config=part,
        detr_encoder_config=part,
        detr_decoder_config={**part, "num_queries": 8},
        mask_decoder_config={"hidden_size": 32, "num_attention_heads": 4},
    )


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with the tiny model and a tokenizer that spells."""
    from transformers import CLIPTokenizer, Sam3Model

    folder = tmp_path_factory.mktemp("sam3")
    letters = string.ascii_lowercase
    tokens = [*letters, *(c + "</w>" for c in letters), "<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({token: index for index, token in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt")).save_pretrained(folder)
    torch.manual_seed(0)
    model = Sam3Model(_tiny_config(len(tokens)))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))  # its own start makes all masks and scores alike
    model.save_pretrained(folder)
    return folder


@pytest.fixture
def copy(weights, tmp_path):
    """A copy of the folder for a test to damage."""
    return shutil.copytree(weights, tmp_path / "weights")


def view(seed=0) -> Frame:
    colour = np.random.default_rng(seed).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    return Frame(colour, np.full((48, 64), 0.6, np.float32), CAMERA)


def test_masks_are_those_of_the_best_instance(weights):
    from transformers import AutoTokenizer, Sam3Model

    segment = Sam3Segmenter(PROMPTS, weights, threshold=0.0)
    frame = view()
    masks = segment(frame)
    assert isinstance(segment, Segmenter) and list(masks) == ["cube", "mug"]
    model, tokenizer = Sam3Model.from_pretrained(weights), AutoTokenizer.from_pretrained(weights)
    for name, text in PROMPTS.items():
        tokens = tokenizer(text, return_tensors="pt", padding="max_length", max_length=32)
        with torch.no_grad():
            output = model(pixel_values=_prepare(frame.colour, 56), **tokens)
        scores = output.pred_logits.sigmoid()[0] * output.presence_logits.sigmoid()[0]
        every = F.interpolate(output.pred_masks.sigmoid(), (48, 64), mode="bilinear")[0] > 0.5  # (8, 48, 64)
        np.testing.assert_allclose(segment.scores[name], float(scores.max()), rtol=1e-5)
        assert masks[name].dtype == bool and 0 < masks[name].mean() < 1
        assert (masks[name] == every[scores.argmax()].numpy()).mean() > 0.999
    assert (masks["cube"] != masks["mug"]).any()


def test_the_published_layout_loads_too(weights, copy):
    """The hub's weights are the video model's, with the image model under ``detector_model``."""
    config = json.loads((copy / "config.json").read_text())
    (copy / "config.json").write_text(json.dumps({"model_type": "sam3_video", "detector_config": config}))
    tensors = {f"detector_model.{name}": tensor for name, tensor in load_file(copy / "model.safetensors").items()}
    tensors["tracker_model.memory"] = torch.zeros(2)
    save_file(tensors, copy / "model.safetensors", {"format": "pt"})
    one, other = (Sam3Segmenter(PROMPTS, folder, threshold=0.0)(view()) for folder in (weights, copy))
    np.testing.assert_array_equal(one["cube"], other["cube"])


def test_images_are_prepared_as_transformers_does():
    """Grey levels that ``Sam3ImageProcessor`` of transformers 5.23 with torchvision 0.28 gives."""
    colour = np.random.default_rng(0).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    pixels = _prepare(colour, (2, 3))
    assert pixels.shape == (1, 3, 2, 3) and pixels.min() >= -1 and pixels.max() <= 1
    expected = [
        [[116, 147, 117], [129, 158, 134]],
        [[131, 123, 146], [107, 120, 163]],
        [[139, 129, 89], [169, 131, 125]],
    ]
    np.testing.assert_allclose(pixels[0] * 127.5 + 127.5, expected, atol=1e-4)


def test_an_entity_below_the_threshold_is_left_out(weights):
    segment = Sam3Segmenter(PROMPTS, weights, threshold=0.0)
    segment(view())
    better, worse = sorted(segment.scores, key=segment.scores.get, reverse=True)
    between = 0.5 * (segment.scores[better] + segment.scores[worse])
    assert list(Sam3Segmenter(PROMPTS, weights, threshold=between)(view())) == [better]
    assert Sam3Segmenter(PROMPTS, weights, threshold=1.0)(view()) == {}


def test_an_entity_that_was_found_is_kept_at_a_lower_score(weights):
    prompt = {"cube": "red cube"}
    probe = Sam3Segmenter(prompt, weights, threshold=0.0)
    scores = {}
    for seed in (0, 1):
        probe(view(seed))
        scores[seed] = probe.scores["cube"]
    strong, weak = sorted(scores, key=scores.get, reverse=True)
    threshold = 0.5 * (scores[strong] + scores[weak])
    plain = Sam3Segmenter(prompt, weights, threshold)
    assert [bool(plain(view(seed))) for seed in (strong, weak)] == [True, False]
    steady = Sam3Segmenter(prompt, weights, threshold, keep=0.5 * scores[weak])
    assert [bool(steady(view(seed))) for seed in (weak, strong, weak, weak)] == [False, True, True, True]
    steady.reset()
    assert steady(view(weak)) == {}


def test_the_gate_takes_phantoms_of_sam3(weights):
    segment = Sam3Segmenter(PROMPTS, weights, threshold=0.0)
    assert HeightGate(segment, low=-9.0, high=9.0)(view()).keys() == PROMPTS.keys()
    assert HeightGate(segment, low=8.0, high=9.0)(view()) == {}


def test_a_missing_extra_is_named(monkeypatch, weights):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(PwmGymError, match=r"pip install 'pwm-gym\[sam3\]'"):
        Sam3Segmenter(PROMPTS, weights)


def test_a_torchvision_that_does_not_fit_is_no_riddle(monkeypatch, weights):
    class Broken(types.ModuleType):
        def __getattr__(self, name):
            raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.setitem(sys.modules, "transformers", Broken("transformers"))
    with pytest.raises(PwmGymError, match="torchvision::nms does not exist"):
        Sam3Segmenter(PROMPTS, weights)


def test_weights_that_cannot_be_had_say_how_to_get_them():
    complaint = r"'facebook/sam3'.*granted at https://huggingface.co/facebook/sam3.*local folder"
    with pytest.raises(PwmGymError, match=complaint):
        Sam3Segmenter(PROMPTS)
    with pytest.raises(PwmGymError, match="'/nowhere/sam3'.*there is no such folder"):
        Sam3Segmenter(PROMPTS, "/nowhere/sam3")


FOREIGN = {
    "no configuration": (lambda f: (f / "config.json").unlink(), "folder has to hold config.json"),
    "no weights": (lambda f: (f / "model.safetensors").unlink(), "folder has to hold config.json, model.safetensors"),
    "torn weights": (lambda f: os.truncate(f / "model.safetensors", 1000), "folder has to hold"),
    "no tokenizer": (lambda f: [p.unlink() for p in f.iterdir() if p.stem[:3] in ("tok", "voc", "mer")], "has 2 words"),
    "another model": (lambda f: (f / "config.json").write_text('{"model_type": "bert"}'), "it is a 'bert' model"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_folder_that_is_not_sam3_is_refused(copy, case):
    damage, complaint = FOREIGN[case]
    damage(copy)
    with pytest.raises(PwmGymError, match=rf"cannot load SAM3's weights .*{complaint}"):
        Sam3Segmenter(PROMPTS, copy)


def test_bad_arguments_are_named(weights):
    with pytest.raises(PwmGymError, match="prompts are {}"):
        Sam3Segmenter({}, weights)
    with pytest.raises(PwmGymError, match="expected a phrase for each entity"):
        Sam3Segmenter({"cube": " "}, weights)
    with pytest.raises(PwmGymError, match=r"keep=0.6 and threshold=0.5"):
        Sam3Segmenter(PROMPTS, weights, keep=0.6)
    with pytest.raises(PwmGymError, match="device='abacus'"):
        Sam3Segmenter(PROMPTS, weights, device="abacus")
    with pytest.raises(PwmGymError, match="no colour"):
        Sam3Segmenter(PROMPTS, weights)(Frame(None, np.ones((48, 64)), CAMERA))


def test_transformers_is_imported_only_where_it_is_used(monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    spec = importlib.util.spec_from_file_location("fresh", sam3.__file__)
    fresh = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)
    assert fresh.Sam3Segmenter is not Sam3Segmenter
