"""A double of MuJoCo Warp that steps every world by MuJoCo itself: what is around the engine is tested by it."""

import copy
import sys
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np

DATA = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")
MODEL = ("body_pos", "body_quat", "site_pos")


class Array:
    """Values (N, ...) float32 with the methods of Warp's arrays that are used."""

    def __init__(self, values):
        self.values = np.array(values, np.float32)

    def assign(self, values):
        assert values.shape == self.values.shape and values.dtype == np.float32
        self.values[:] = values

    def numpy(self):
        return self.values.copy()

    def zero_(self):
        self.values[:] = 0.0


def arrays(source, names, worlds):
    return {name: Array(np.repeat(getattr(source, name)[None], worlds, 0)) for name in names}


def put_model(model, batched):
    assert {*batched} <= {*MODEL}
    worlds = {*batched.values()}.pop()
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # which Warp does not have
    return SimpleNamespace(mujoco=model, **arrays(model, MODEL, worlds))


def make_data(model, nworld, nconmax, njmax):
    assert njmax >= nconmax > 0
    data = mujoco.MjData(model)
    own = [mujoco.MjData(model) for _ in range(nworld)]
    overflow = Array(np.zeros(nworld))
    return SimpleNamespace(mujoco=own, room=nconmax, overflow=overflow, **arrays(data, DATA, nworld))


def step(model, data):
    for k, own in enumerate(data.mujoco):
        for name in MODEL:
            getattr(model.mujoco, name)[:] = getattr(model, name).values[k]
        for name in DATA:
            getattr(own, name)[:] = getattr(data, name).values[k]
        mujoco.mj_step(model.mujoco, own)
        data.overflow.values[k] += own.ncon > data.room
        for name in DATA:
            getattr(data, name).values[k] = getattr(own, name)


class Device:
    """A context that does nothing."""

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None


def install(monkeypatch):
    """Put the double in the place of both packages."""
    engine, warp = ModuleType("mujoco_warp"), ModuleType("warp")
    engine.put_model, engine.make_data, engine.step = put_model, make_data, step
    warp.get_device, warp.ScopedDevice = lambda name: name, lambda device: Device()
    monkeypatch.setitem(sys.modules, "mujoco_warp", engine)
    monkeypatch.setitem(sys.modules, "warp", warp)
