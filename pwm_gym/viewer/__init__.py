"""Pictures of clouds: a NumPy splat renderer, and the world model beside its simulator."""

from pwm_gym.viewer.camera import Camera, frame_camera, tabletop_camera
from pwm_gym.viewer.overlays import draw_overlays
from pwm_gym.viewer.page import write_html
from pwm_gym.viewer.palette import BACKGROUND, GOAL, PREDICTED, TRUE, entity_colors, tint
from pwm_gym.viewer.splat import render
from pwm_gym.viewer.summaries import draw_calibration, draw_growth, draw_quartiles
from pwm_gym.viewer.twin import TwinRecord, twin_frame, write_gif, write_mp4, write_png

__all__ = [
    "BACKGROUND",
    "GOAL",
    "PREDICTED",
    "TRUE",
    "Camera",
    "TwinRecord",
    "draw_calibration",
    "draw_growth",
    "draw_overlays",
    "draw_quartiles",
    "entity_colors",
    "frame_camera",
    "render",
    "tabletop_camera",
    "tint",
    "twin_frame",
    "write_gif",
    "write_html",
    "write_mp4",
    "write_png",
]
