"""Completion of partial clouds: the network, its training, and the shapes it learns from, random or read from files."""

from pwm_gym.completion.checkpoint import SHIPPED, load_completion, save_completion
from pwm_gym.completion.completer import Completer, Completion, HullCompleter, LearnedCompleter, build_completer
from pwm_gym.completion.fitting import ObjectSet, fit_completion, random_shapes
from pwm_gym.completion.frame import LEAST, ViewerFrame
from pwm_gym.completion.meshes import load_meshes, normalise
from pwm_gym.completion.network import SIZES, CompletionConfig, CompletionNet, get_size
from pwm_gym.completion.training import CompletionLoss, CompletionTrainConfig, chamfer_loss, train_completion
from pwm_gym.completion.views import Batch, ObjectView, ViewConfig, Views

__all__ = [
    "LEAST",
    "SHIPPED",
    "SIZES",
    "Batch",
    "Completer",
    "Completion",
    "CompletionConfig",
    "CompletionLoss",
    "CompletionNet",
    "CompletionTrainConfig",
    "HullCompleter",
    "LearnedCompleter",
    "ObjectSet",
    "ObjectView",
    "ViewConfig",
    "ViewerFrame",
    "Views",
    "build_completer",
    "chamfer_loss",
    "fit_completion",
    "get_size",
    "load_completion",
    "load_meshes",
    "normalise",
    "random_shapes",
    "save_completion",
    "train_completion",
]
