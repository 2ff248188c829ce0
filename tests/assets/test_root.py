import builtins

import pytest

from pwm_gym.assets import MissingAssetsError, asset_root, require_ycb, use_assets


def test_maniskills_own_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("MS_ASSET_DIR", str(tmp_path))
    assert asset_root() == tmp_path
    monkeypatch.delenv("MS_ASSET_DIR")
    assert asset_root().name == ".maniskill"


def test_missing_objects_are_one_error_with_both_ways_and_no_question(monkeypatch, tmp_path):
    monkeypatch.setattr(builtins, "input", lambda *args: pytest.fail("asked"))
    monkeypatch.setenv("MS_ASSET_DIR", str(tmp_path))
    with pytest.raises(MissingAssetsError) as error:
        require_ycb()
    text = str(error.value)
    assert f"pwm-gym assets ycb --from MESHES --out {tmp_path}" in text
    assert "python -m mani_skill.utils.download_asset ycb" in text and "\n" not in text


def test_a_missing_object_is_named(shapes):
    assert require_ycb(shapes.root, ("shape_box",)) == shapes
    with pytest.raises(MissingAssetsError, match="has no object '011_banana'"):
        require_ycb(shapes.root, ("011_banana",))


def test_maniskill_reads_the_folder_though_it_was_imported_before(shapes):
    use_assets(shapes)
    from mani_skill.envs.tasks.tabletop import pick_single_ycb
    from mani_skill.utils.assets.data import DATA_SOURCES, is_data_source_downloaded

    assert shapes.root.resolve() / "data" == pick_single_ycb.ASSET_DIR
    assert is_data_source_downloaded("ycb")  # so that ManiSkill asks nothing
    others = {DATA_SOURCES[name].output_dir for name in ("assembling_kits", "pick_clutter_ycb_configs")}
    assert shapes.root.resolve() / "data" not in others
