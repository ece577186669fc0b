"""Images and labels of all kinds, read as the tools of their formats read them."""

import json
import warnings

import numpy as np
import pytest
from image_toys import square, squares
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from sada_gym.envs.images import dataset
from sada_gym.envs.images.dataset import image_set, read_image
from sada_gym.errors import Notice, UserError


@pytest.fixture
def folder(tmp_path):
    """Four images of different kinds."""
    pixels = square(30, 20)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    Image.fromarray(pixels).save(tmp_path / "b.jpg", quality=95)
    Image.fromarray(pixels).save(tmp_path / "c.webp", lossless=True)
    Image.fromarray(pixels[..., 0].astype(np.uint16) * 257).save(tmp_path / "d.png")
    return tmp_path


def test_images_of_all_kinds_are_read_alike(folder):
    found = image_set(folder)
    assert found.names == ["a.png", "b.jpg", "c.webp", "d.png"]
    pixels = square(30, 20)
    for i, tolerance in enumerate((0, 12, 0, 0)):
        assert found.image(i).dtype == np.uint8
        assert np.abs(found.image(i).astype(int) - pixels).max() <= tolerance


def test_exif_turns_an_image_and_transparency_lies_on_white(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn
    Image.fromarray(square(30, 20)).save(tmp_path / "turned.jpg", exif=exif)
    assert read_image(tmp_path / "turned.jpg").shape == (128, 96, 3)
    clear = np.zeros((4, 4, 4), np.uint8)
    clear[:2, :, 3] = 255
    Image.fromarray(clear).save(tmp_path / "clear.png")
    assert_array_equal(read_image(tmp_path / "clear.png")[:, 0, 0], [0, 0, 255, 255])
    Image.fromarray(square(1, 1)).convert("L").save(tmp_path / "grey.png")
    assert read_image(tmp_path / "grey.png").shape == (96, 128, 3)


def test_folders_are_classes_as_torchvision_has_them(tmp_path):
    for name in ("tabby", "Siamese", "tabby/young"):
        (tmp_path / name).mkdir()
        Image.fromarray(square(1, 1)).save(tmp_path / name / "x.png")
    found = image_set(tmp_path)
    assert found.classes == {0: "Siamese", 1: "tabby"}
    assert [int(label.classes[0]) for label in found.labels] == [0, 1, 1]
    assert image_set(tmp_path, False).labels is None
    for name in ("281", "7"):
        (tmp_path / "numbers" / name).mkdir(parents=True)
        Image.fromarray(square(1, 1)).save(tmp_path / "numbers" / name / "x.png")
    numbered = image_set(tmp_path / "numbers")
    assert [int(label.classes[0]) for label in numbered.labels] == [281, 7]


def test_class_folders_are_numbered_as_torchvision_does(tmp_path):
    root = tmp_path / "root"
    for name in ("b", "B", "a/young", "empty"):
        (root / name).mkdir(parents=True)
    for name in ("b/1.ppm", "B/2.png", "a/young/3.PNG"):
        Image.fromarray(square(1, 1)).save(root / name)
    (root / "link").symlink_to(root / "b")
    found = image_set(root)
    assert found.classes == {0: "B", 1: "a", 2: "b", 3: "empty", 4: "link"}
    numbers = [int(label.classes[0]) for label in found.labels]
    assert [*zip(found.names, numbers, strict=True)] == [
        *(("B/2.png", 0), ("a/young/3.PNG", 1), ("b/1.ppm", 2), ("link/1.ppm", 4))
    ]
    theirs = pytest.importorskip("torchvision.datasets").ImageFolder(str(root), allow_empty=True)
    assert theirs.class_to_idx == {name: i for i, name in found.classes.items()}
    assert theirs.targets == numbers


def test_images_of_one_name_in_two_folders_keep_their_own_labels(tmp_path):
    names = ("train/a", "val/a")
    for i, name in enumerate(names):
        for top in ("images", "labels"):
            (tmp_path / top / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(square(1, 1)).save(tmp_path / f"images/{name}.png")
        (tmp_path / f"labels/{name}.txt").write_text(f"{i} 0.5 0.5 0.2 0.2")
    table = {
        "images": [{"id": i, "file_name": f"{name}.png"} for i, name in enumerate(names)],
        "categories": [{"id": i, "name": str(i)} for i in range(2)],
        "annotations": [
            {"id": i, "image_id": i, "category_id": i, "bbox": [1, 1, 9, 9]} for i in range(2)
        ],
    }
    (tmp_path / "instances.json").write_text(json.dumps(table))
    for labels in (tmp_path / "labels", tmp_path / "instances.json"):
        known = image_set(tmp_path / "images", labels).labels
        assert [label.classes.tolist() for label in known] == [[0], [1]]
        files = [tmp_path / f"images/{name}.png" for name in names]
        with pytest.raises(UserError, match=r"Expected labels of one image named a.* for 2 such"):
            image_set(files, labels)
        with pytest.raises(UserError, match=r"got those of train/a.*, val/a.* for 1 such"):
            image_set(files[:1], labels)


def coco_file(folder, rows):
    table = {
        "images": [{"id": 7, "file_name": "a.png"}, {"id": 9, "file_name": "train/b.jpg"}],
        "categories": [{"id": 1, "name": "person"}, {"id": 3, "name": "car"}],
        "annotations": rows,
    }
    (folder / "instances.json").write_text(json.dumps(table))
    return folder / "instances.json"


def test_cocos_instances_are_read(folder):
    rows = [
        {"id": 1, "image_id": 7, "category_id": 3, "bbox": [30, 20, 24, 24], "iscrowd": 0},
        {"id": 2, "image_id": 9, "category_id": 1, "bbox": [0.5, 0, 10, 96], "iscrowd": 0},
        {"id": 3, "image_id": 9, "category_id": 1, "bbox": [0, 0, 128, 96], "iscrowd": 1},
    ]
    path = coco_file(folder, rows)
    found = image_set(folder, path)
    assert found.names == ["a.png", "b.jpg"]  # the images that the file names
    assert found.classes == {1: "person", 3: "car"}
    assert_allclose(found.labels[0].boxes, [[30, 20, 54, 44]])
    assert_allclose(found.labels[1].boxes, [[0.5, 0, 10.5, 96]])
    tools = pytest.importorskip("pycocotools.coco")
    theirs = tools.COCO(str(path))
    for i, number in enumerate((7, 9)):
        kept = theirs.loadAnns(theirs.getAnnIds(number, iscrowd=False))
        boxes = np.array([row["bbox"] for row in kept])
        assert_allclose(found.labels[i].boxes[:, :2], boxes[:, :2])
        assert_allclose(found.labels[i].boxes[:, 2:] - boxes[:, :2], boxes[:, 2:])
        assert found.labels[i].classes.tolist() == [row["category_id"] for row in kept]


def test_yolos_text_files_are_read(folder):
    labels = folder / "labels"
    labels.mkdir()
    (labels / "a.txt").write_text("0 0.328125 0.333333 0.1875 0.25\n\n")
    (labels / "b.txt").write_text("1 0.25 0.25 0.75 0.25 0.5 0.75\n")
    found = image_set(folder, labels, classes=["car", "person"])
    assert found.classes == {0: "car", 1: "person"}
    assert_allclose(found.labels[0].boxes, [[30, 20, 54, 44]], atol=1e-3)
    assert_allclose(found.labels[1].boxes, [[32, 24, 96, 72]])  # around a polygon
    assert [len(label.boxes) for label in found.labels] == [1, 1, 0, 0]
    tools = pytest.importorskip("supervision")
    (folder / "data.yaml").write_text("names: [car, person]")
    theirs = tools.DetectionDataset.from_yolo(str(folder), str(labels), str(folder / "data.yaml"))
    for i in range(2):
        detections = theirs.annotations[str(folder / found.names[i])]
        assert_allclose(found.labels[i].boxes, detections.xyxy, atol=1e-3)
        assert found.labels[i].classes.tolist() == detections.class_id.tolist()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("0 0.5 0.5 0.2", "`class x y width height` in line 1 of .*a.txt"),
        ("0 0.5 0.5 0.2 nought", "in line 1 of .*a.txt"),
        ("0 0.5 0.5 0.2 1.5", "boxes inside of a.png, which is 128 x 96 px, got .* in .*a.txt"),
        ("0 0.5 0.5 0 0.5", "boxes inside of a.png"),
    ],
)
def test_a_bad_line_gets_a_sentence_with_the_files_name(folder, text, told):
    labels = folder / "labels"
    labels.mkdir()
    (labels / "a.txt").write_text(text)
    with pytest.raises(UserError, match=told):
        image_set(folder, labels)


def test_bad_labels_get_a_sentence(folder, tmp_path):
    with pytest.raises(UserError, match=r"files of .*instances.json, such as 'a.png', among"):
        image_set(squares(2)[0], coco_file(folder, []))
    (folder / "other.json").write_text("[]")
    with pytest.raises(UserError, match=r"COCO's instances in .*other.json"):
        image_set(folder, folder / "other.json")
    (folder / "none").mkdir()
    with pytest.raises(UserError, match=r"a text file for an image in .*, such as a.txt, got none"):
        image_set(folder, folder / "none")
    with pytest.raises(UserError, match=r"COCO's .json file or a folder of YOLO's"):
        image_set(folder, folder / "a.png")
    images, labels = squares(3)
    with pytest.raises(UserError, match="a label for each of 3 images, got 2"):
        image_set(images, labels[:2])
    with pytest.raises(UserError, match=r"boxes .* for image 0, got 1 boxes and labels int64"):
        image_set(images, [{"boxes": [[1, 2, 3, 4]], "labels": [1, 2]}, *labels[1:]])
    with pytest.raises(UserError, match="class of each image as a whole number from 0"):
        image_set(images, [0.5, 1.0, 2.0])


def test_no_images_and_what_is_none_get_a_sentence(tmp_path, monkeypatch):
    with pytest.raises(UserError, match=r"at least one image .*, got none"):
        image_set(tmp_path)
    with pytest.raises(UserError, match=r"a folder of images, got .*nowhere"):
        image_set(tmp_path / "nowhere")
    with pytest.raises(UserError, match=r"image 0 as an array .* uint8, got float64 \(4, 4, 3\)"):
        image_set([np.zeros((4, 4, 3))])
    with pytest.raises(UserError, match="images as a folder, a list of files, or arrays"):
        image_set(3)
    monkeypatch.setattr(dataset, "MAX_PIXELS", 100)
    Image.fromarray(square(1, 1)).save(tmp_path / "large.png")
    with pytest.raises(UserError, match=r"in all in .*large.png, got 128 x 96"):
        image_set(tmp_path)


def test_a_damaged_image_is_told_or_left_out(folder):
    whole = (folder / "b.jpg").read_bytes()
    (folder / "b.jpg").write_bytes(whole[: len(whole) // 2])
    (folder / "z.png").write_bytes(b"no image")
    with pytest.raises(UserError, match=r"an image in .*z.png, got: .* skip_unreadable"):
        image_set(folder)
    with pytest.warns(Notice, match=r"2 of 5 images cannot be read and are left out: b.jpg, z.png"):
        found = image_set(folder, skip_unreadable=True)
    assert found.names == ["a.png", "c.webp", "d.png"]
    (folder / "z.png").unlink()
    broken = image_set(folder)  # headers alone do not show it
    with pytest.raises(UserError, match=r"an image in .*b.jpg"):
        broken.image(1)


def test_memory_stays_flat_and_an_image_is_read_once(folder, monkeypatch):
    found = image_set([folder / "a.png"] * 10)
    monkeypatch.setattr(dataset, "_KEPT_BYTES", 3 * found.image(0).nbytes)
    for i in range(10):
        found.image(i)
    assert len(found._kept) == 3
    reads = []
    monkeypatch.setattr(dataset, "read_image", lambda path: reads.append(path))
    found.image(9)
    assert not reads


def test_the_hash_follows_images_and_labels(folder):
    images, labels = squares(3)
    first = image_set(images, labels).sha256
    assert image_set([*map(np.array, images)], labels).sha256 == first
    assert (
        image_set(images, [*labels[:2], {"boxes": [[1, 1, 5, 5]], "labels": [1]}]).sha256 != first
    )
    images[0] = images[0].copy()
    images[0][0, 0, 0] += 1
    assert image_set(images, labels).sha256 != first
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert image_set(folder).sha256 == image_set(str(folder)).sha256


def test_an_unreadable_image_takes_no_other_ones_label_away(folder):
    """The files that COCO names come in another order, and not all of them."""
    (folder / "0.png").write_bytes(b"no image")
    row = {"id": 1, "image_id": 9, "category_id": 1, "bbox": [1, 2, 10, 20]}
    path = coco_file(folder, [row])
    table = json.loads(path.read_text())
    table["images"].append({"id": 1, "file_name": "0.png"})
    table["annotations"].append({**row, "image_id": 1})
    path.write_text(json.dumps(table))
    with pytest.warns(Notice) as told:
        found = image_set(folder, path, skip_unreadable=True)
    assert found.names == ["a.png", "b.jpg"]
    assert [len(label.boxes) for label in found.labels] == [0, 1]
    texts = [str(notice.message) for notice in told]
    assert texts[0] == "1 of 5 images cannot be read and are left out: 0.png."
    assert texts[1] == f"1 of 3 labels in {path} have no image: 0.png."
    labels = folder / "labels"
    labels.mkdir()
    for name in ("a", "classes", "gone", "lost"):
        (labels / f"{name}.txt").write_text("0 0.5 0.5 0.2 0.2" if name != "classes" else "car\n")
    with pytest.warns(Notice, match="2 of 4 labels in .* have no image: gone, lost."):
        image_set([folder / "a.png"], labels)


def test_an_image_of_twenty_thousand_pixels_a_side_is_told_or_left_out(folder, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)  # Pillow itself refuses twice as many
    with pytest.raises(UserError, match=r"in all in .*a.png, got far more. Scale it down, or pass"):
        image_set(folder)
    with pytest.raises(UserError, match=r"in all in .*a.png, got far more"):
        image_set(folder, skip_unreadable=True)
