"""A stack of images becomes solid and void with lengths in metres, or one sentence."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import images, read_images
from multiscale.io.images import VoxelImage
from tests.support import run_python

tifffile = pytest.importorskip("tifffile")


@pytest.fixture
def void():
    """An image with three different edges, (nx, ny, nz)."""
    return np.random.default_rng(seed=3).uniform(size=(5, 4, 3)) < 0.3


def pages(void):
    """Grey values as a tomograph gives them: z, y, x, solid bright."""
    return np.where(void, 0, 255).astype(np.uint8).transpose(2, 1, 0)


def write_imagej(path, void, **metadata):
    tifffile.imwrite(
        path, pages(void), imagej=True, resolution=(2.0, 4.0), metadata={"axes": "ZYX", **metadata}
    )
    return path


def test_a_stack_is_read_with_the_size_of_its_voxels(void, tmp_path):
    path = write_imagej(tmp_path / "stack.tif", void, spacing=0.75, unit="um")
    image = read_images(path)
    np.testing.assert_array_equal(image.void, void)
    assert image.spacing == pytest.approx((0.5e-6, 0.25e-6, 0.75e-6))


def test_given_edges_come_before_the_edges_in_the_file(void, tmp_path):
    path = write_imagej(tmp_path / "stack.tif", void, spacing=0.75, unit="um")
    assert read_images(path, voxel_size=2e-6).size == pytest.approx((1e-5, 8e-6, 6e-6))


def test_slices_in_a_folder_are_a_stack(void, tmp_path):
    for k, page in enumerate(pages(void)):
        tifffile.imwrite(tmp_path / f"slice-{9 + k}.tif", page)  # 9, 10, 11
    image = read_images(tmp_path, voxel_size=(1.0, 2.0, 3.0))
    np.testing.assert_array_equal(image.void, void)
    assert image.spacing == pytest.approx((1.0, 2.0, 3.0))


def test_voxels_of_other_edges_need_all_three(void, tmp_path):
    path = write_imagej(tmp_path / "stack.tif", void)
    with pytest.raises(CaseError, match=r"three edges along x, y and z \(m\), got \(1, 2\)"):
        read_images(path, voxel_size=(1, 2))
    with pytest.raises(CaseError, match="needs three axes"):
        VoxelImage(np.zeros((3, 3)), (1.0, 1.0, 1.0))


def test_the_void_may_be_bright(void, tmp_path):
    path = write_imagej(tmp_path / "stack.tif", void)
    np.testing.assert_array_equal(
        read_images(path, void_value=255, voxel_size=1.0).void, np.logical_not(void)
    )


def test_half_the_resolution_keeps_size_and_porosity():
    void = np.random.default_rng(seed=3).uniform(size=(40, 40, 40)) < 0.5
    coarse = VoxelImage(void, (1.0, 2.0, 3.0)).coarsened()
    assert coarse.void.shape == (20, 20, 20)
    assert coarse.size == (1.0, 2.0, 3.0)
    assert coarse.porosity == pytest.approx(0.5, abs=0.03)


def test_solid_floats_that_meets_no_other_by_a_face():
    solid = np.zeros((7, 7, 7), bool)
    solid[:2] = True  # the largest component
    touching, apart, cut, between = ((2, 3, 3), (4, 1, 1), (6, 3, 3), (6, 6, 3))
    for voxel in (touching, apart, cut, between):
        solid[voxel] = True
    image = VoxelImage(~solid, (7.0, 7.0, 7.0))
    np.testing.assert_array_equal(np.argwhere(image.floating), [apart, cut])
    whole = image.without_floating()
    assert not whole.floating.any()
    assert whole.porosity == pytest.approx(image.porosity + 2 / 343, rel=1e-12)
    assert not VoxelImage(np.ones((2, 2, 2)), (1.0, 1.0, 1.0)).floating.any()


def test_an_image_contains_only_the_values_0_and_1():
    assert VoxelImage(np.eye(3, dtype=int)[None], (1.0, 1.0, 1.0)).porosity == pytest.approx(1 / 3)


def test_an_unreadable_image_is_refused_with_a_sentence(void, tmp_path):
    plain = write_imagej(tmp_path / "plain.tif", void)
    grey = tmp_path / "grey.tif"
    tifffile.imwrite(grey, np.arange(60, dtype=np.uint8).reshape(3, 4, 5), photometric="minisblack")
    flat, colour, broken = (tmp_path / name for name in ("flat.tif", "colour.tif", "broken.tif"))
    tifffile.imwrite(flat, np.zeros((4, 5), dtype=np.uint8))
    tifffile.imwrite(colour, np.zeros((3, 4, 5, 3), dtype=np.uint8), photometric="rgb")
    broken.write_bytes(plain.read_bytes()[:40])
    (tmp_path / "empty").mkdir()
    for path, sentence in (
        (tmp_path / "none.tif", "no such file"),
        (plain, r"does not give the size of its voxels along x, y and z; give voxel_size"),
        (grey, r"not a binary image with void 0: 60 values from 0 to 59; threshold it first"),
        (flat, r"shape \(4, 5\); give a stack"),
        (colour, r"shape \(3, 4, 5, 3\); give a stack"),
        (broken, "cannot be read as images"),
        (tmp_path / "empty", "has no .tif file"),
    ):
        with pytest.raises(CaseError, match=sentence):
            read_images(path)
    with pytest.raises(CaseError, match="three positive lengths"):
        read_images(plain, voxel_size=-1.0)


def test_an_image_of_too_many_voxels_is_refused(void, tmp_path, monkeypatch):
    stack, slices = write_imagej(tmp_path / "deep.tif", void), tmp_path / "slices"
    slices.mkdir()
    for k, page in enumerate(pages(void)):
        tifffile.imwrite(slices / f"{k}.tif", page)
    monkeypatch.setattr(images, "MOST_VOXELS", void.size - 1)
    for path in (stack, slices):
        with pytest.raises(CaseError, match="the image has more than 59 voxels; give a part"):
            read_images(path)


def test_without_the_library_the_sentence_names_the_package_to_install(void, tmp_path):
    path = write_imagej(tmp_path / "plain.tif", void)
    code = (
        "import sys; sys.modules['tifffile'] = None\n"
        "from multiscale.io import read_images\n"
        f"read_images({str(path)!r})"
    )
    done = run_python(code, check=False)
    assert "reading images needs tifffile; install it with pip install" in done.stderr


def test_slices_of_two_formats_are_refused(void, tmp_path):
    for k, page in enumerate(pages(void)):
        tifffile.imwrite(tmp_path / f"{k}.tif", page.astype(np.uint16) if k == 1 else page)
    with pytest.raises(CaseError, match=r"two formats, .* uint8 in 0.tif and .* uint16 in 1.tif"):
        read_images(tmp_path, voxel_size=1e-6)


def test_a_window_is_cut_out_of_the_corner_that_is_named():
    void = np.arange(4 * 6 * 8).reshape(4, 6, 8) % 5 == 0
    cut = VoxelImage(void, (4.0, 6.0, 8.0)).window(0.5, (1, 0, 1))
    np.testing.assert_array_equal(cut.void, void[2:, :3, 4:])
    assert cut.size == (2.0, 3.0, 4.0)
