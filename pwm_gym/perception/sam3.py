"""Segmentation by text prompts with SAM3 (Carion et al. 2025), run by transformers.

The model is transformers' own. Its image processor is not used: that one needs torchvision, whose wheels on PyPI are
built for CUDA and cannot be imported beside a CPU build of PyTorch. What it does here is a resize and a threshold.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import SafetensorError
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.perception.frame import Frame

__all__ = ["Sam3Segmenter"]

_WORDS = 32  # tokens of a prompt that the text encoder reads
_TYPES = ("sam3", "sam3_video")  # the published weights are those of the video model, which holds the image model


class Sam3Segmenter:
    """Finds each entity by a phrase that describes it: the best-scoring instance of each prompt.

    SAM3 has 840 M parameters and sees images at 1008 x 1008 pixels. Its weights on the hub are gated: accept their
    terms on the model's page and log in (``hf auth login``), or give a local folder. Each prompt is run on its own;
    the image is encoded once.

    Known troubles, and what helps:

    * An object's score flickers around the threshold from frame to frame: give ``keep``.
    * Objects that are held or partly hidden are missed; they are left out of the result, and the caller keeps their
      last cloud. Where this happens often, :class:`~pwm_gym.perception.MaskSegmenter` takes a tracker's masks.
    * A prompt may match the table's pattern or the robot: wrap it in :class:`~pwm_gym.perception.HeightGate`.
    * Prompts may match the same object; nothing keeps two masks from overlapping. Tell objects apart by colour or
      kind ("red cube").

    Args:
        prompts: entity name to a short noun phrase, such as ``{"cube": "red cube"}``.
        model: the model's id on the hub, or a local folder with its weights and its tokenizer.
        threshold: least score of an instance, between 0 and 1.
        device: PyTorch device.
        keep: least score of an entity that was found in the last frame (hysteresis); None: ``threshold``.
        mask_threshold: least probability of a pixel of the mask.

    Attributes:
        scores: best score of each entity in the last frame, found or not.

    Raises:
        PwmGymError: transformers or the weights are missing, a prompt is empty, or thresholds are in the wrong order.
    """

    def __init__(
        self,
        prompts: Mapping[str, str],
        model: str | Path = "facebook/sam3",
        threshold: float = 0.5,
        device: str = "cpu",
        *,
        keep: float | None = None,
        mask_threshold: float = 0.5,
    ) -> None:
        if not prompts or not all(isinstance(text, str) and text.strip() for text in prompts.values()):
            raise PwmGymError(f"prompts are {dict(prompts)}; expected a phrase for each entity")
        keep = threshold if keep is None else keep
        if not 0 <= keep <= threshold <= 1:
            raise PwmGymError(f"keep={keep} and threshold={threshold}; expected 0 <= keep <= threshold <= 1")
        self._network, tokenizer = _load(str(model), device)
        self._tokens = {name: _tokenize(tokenizer, text).to(device) for name, text in prompts.items()}
        self._device, self._threshold, self._keep, self._mask_threshold = device, threshold, keep, mask_threshold
        self.reset()

    def reset(self) -> None:
        """Forget which entities the last frame had."""
        self.scores: dict[str, float] = {}
        self._seen: set[str] = set()

    @torch.inference_mode()
    def __call__(self, frame: Frame) -> dict[str, np.ndarray]:
        """Masks of the prompts that were found.

        Raises:
            PwmGymError: the frame has no colour.
        """
        if frame.colour is None:
            raise PwmGymError("the frame has no colour, and SAM3 reads nothing else")
        pixels = _prepare(frame.colour, self._network.config.image_size).to(self._device)
        view = self._network.get_vision_features(pixel_values=pixels)
        found = {}
        for name, tokens in self._tokens.items():
            self.scores[name], logits = _best(self._network(vision_embeds=view, **tokens))
            mask = _mask(logits, frame.depth.shape, self._mask_threshold)
            if mask.any() and self.scores[name] > (self._keep if name in self._seen else self._threshold):
                found[name] = mask
        self._seen = set(found)
        return found


def _load(model: str, device: str) -> tuple[Any, Any]:
    """SAM3's image model, ready to run, and its tokenizer."""
    try:
        from transformers import AutoConfig, AutoTokenizer, Sam3Model
    except (ImportError, RuntimeError) as cause:  # RuntimeError: a torchvision that does not fit PyTorch
        raise PwmGymError(f"{_line(cause)}; SAM3 needs transformers: pip install 'pwm-gym[sam3]'") from cause
    try:
        kind = AutoConfig.from_pretrained(model).model_type
        if kind not in _TYPES:
            raise PwmGymError(f"it is a {kind!r} model; expected {' or '.join(_TYPES)}")
        network, tokenizer = Sam3Model.from_pretrained(model), AutoTokenizer.from_pretrained(model)
        if len(tokenizer) < (words := network.config.text_config.vocab_size):  # without its files it loads empty
            raise PwmGymError(f"its tokenizer has {len(tokenizer)} words; expected {words}")
    except (ImportError, KeyError, OSError, RuntimeError, ValueError, SafetensorError) as cause:
        raise PwmGymError(f"cannot load SAM3's weights {model!r} ({_line(cause)}); {_remedy(model)}") from cause
    try:
        return network.eval().to(device), tokenizer
    except (AssertionError, RuntimeError) as cause:
        raise PwmGymError(f"cannot run SAM3 on device={device!r} ({_line(cause)})") from cause


def _remedy(model: str) -> str:
    if Path(model).is_dir():
        return "the folder has to hold config.json, model.safetensors and the tokenizer's files"
    if model.count("/") != 1 or model[0] in "./~":
        return "there is no such folder, and an id of the hub is <owner>/<name>"
    page = f"https://huggingface.co/{model}"
    return f"access must be granted at {page} (then `hf auth login`), or give model= a local folder"


def _line(cause: Exception) -> str:
    """First line of a message: the rest of transformers' are advice for other cases."""
    return str(cause).strip().partition("\n")[0].rstrip(".")


def _tokenize(tokenizer: Any, text: str) -> Any:
    return tokenizer(text, return_tensors="pt", padding="max_length", max_length=_WORDS, truncation=True)


def _prepare(colour: np.ndarray, size: int | tuple[int, int] | list[int]) -> Tensor:
    """An image (H, W, 3) as the model takes it: (1, 3, S, S), -1 to 1; as transformers' ``Sam3ImageProcessor``."""
    image = torch.from_numpy(np.ascontiguousarray(colour)).permute(2, 0, 1)[None]  # uint8, as there
    side = (size, size) if isinstance(size, int) else tuple(size)
    image = F.interpolate(image, side, mode="bilinear", align_corners=False, antialias=True)
    return (image.float() / 255 - 0.5) / 0.5


def _best(output: Any) -> tuple[float, Tensor]:
    """Score and mask logits (h, w) of the best instance; as ``Sam3Processor.post_process_instance_segmentation``."""
    scores = output.pred_logits[0].sigmoid() * output.presence_logits[0].sigmoid()  # (queries,)
    best = int(scores.argmax())
    return float(scores[best]), output.pred_masks[0, best]


def _mask(logits: Tensor, shape: tuple[int, ...], threshold: float) -> np.ndarray:
    probability = F.interpolate(logits.float().sigmoid()[None, None], shape, mode="bilinear", align_corners=False)
    return (probability[0, 0] > threshold).cpu().numpy()
