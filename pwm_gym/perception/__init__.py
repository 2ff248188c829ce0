"""From RGB-D views to complete scenes: frames, segmenters, cleaning of depth, tracking, and all of it in one call."""

from pwm_gym.perception.cleaning import Cleaning, clean, clusters, depth_edges, inliers, median_depth
from pwm_gym.perception.frame import Frame, load_frames
from pwm_gym.perception.observer import Observation, SceneObserver
from pwm_gym.perception.rendered import FrameRenderer, RenderedObserver
from pwm_gym.perception.sam3 import Sam3Segmenter
from pwm_gym.perception.segmenters import HeightGate, IdSegmenter, MaskSegmenter, Segmenter
from pwm_gym.perception.tracking import Registration, Tracker, TrackingConfig, register

__all__ = [
    "Cleaning",
    "Frame",
    "FrameRenderer",
    "HeightGate",
    "IdSegmenter",
    "MaskSegmenter",
    "Observation",
    "Registration",
    "RenderedObserver",
    "Sam3Segmenter",
    "SceneObserver",
    "Segmenter",
    "Tracker",
    "TrackingConfig",
    "clean",
    "clusters",
    "depth_edges",
    "inliers",
    "load_frames",
    "median_depth",
    "register",
]
