"""From an RGB-D view to clean points of objects: frames, segmenters and the cleaning of depth."""

from pwm_gym.perception.cleaning import Cleaning, clean, clusters, depth_edges, inliers, median_depth
from pwm_gym.perception.frame import Frame, load_frames
from pwm_gym.perception.sam3 import Sam3Segmenter
from pwm_gym.perception.segmenters import HeightGate, IdSegmenter, MaskSegmenter, Segmenter

__all__ = [
    "Cleaning",
    "Frame",
    "HeightGate",
    "IdSegmenter",
    "MaskSegmenter",
    "Sam3Segmenter",
    "Segmenter",
    "clean",
    "clusters",
    "depth_edges",
    "inliers",
    "load_frames",
    "median_depth",
]
