"""Training of the verifier on images, on tiny data."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from reorient.cli import main
from reorient.errors import ReorientError
from reorient.estimators.image_evidence import CHANNELS, COMPARED, SIZE
from reorient.estimators.image_verifier import load_image_verifier
from reorient.estimators.verifier import FEATURES
from reorient.learning.image_network import ImageNetwork, loss
from reorient.learning.image_sets import ImageSets, read_sets
from reorient.learning.image_training import Run, finish, log_odds_of
from reorient.learning.recipes import ImageTraining

TINY = ImageTraining(rounds=2, steps=25, sets=12, held_out=0.3)


@pytest.fixture(scope="module")
def data():
    """Sets of three hypotheses that the trees do not distinguish: both images agree with the right one, mostly."""
    rng = np.random.default_rng(0)
    sets, n = 80, 240
    right = (np.arange(n) + rng.integers(3, size=sets).repeat(3)) % 3 == 0
    agree = np.where(rng.random(sets).repeat(3) < 0.15, np.roll(right, 1), right)
    images = np.zeros((n, 2, len(CHANNELS), SIZE, SIZE), np.uint8)
    images[:, :, 0, 10:40, 10:40] = np.where(agree, 128, 60)[:, None, None, None]
    images[:, :, 1, 10:40, 10:40] = COMPARED
    number = np.arange(n) // 3
    return ImageSets(
        images=images,
        features=rng.normal(size=(n, len(FEATURES))).astype(np.float32),
        log_odds=rng.normal(size=n).astype(np.float32),
        error_deg=np.where(right, 1.0, 90.0),
        object=number // 2,
        angle_deg=np.full(n, 90.0),
        first=np.arange(0, n, 3),
    )


def test_it_learns_what_the_images_show_and_writes_it(data, tmp_path):
    run = Run(data, tmp_path / "run", TINY)
    rounds = list(run.go_on())
    assert [x.number for x in rounds] == [1, 2]
    assert rounds[-1].right > 0.7 > 0.6 > rounds[-1].right_by_trees
    (figures,) = run.compared()
    assert figures["sets"] * (figures["right"] - figures["trees"]) == pytest.approx(figures["won"] - figures["lost"])
    calibration = finish(run, tmp_path / "images.onnx")
    verifier = load_image_verifier(tmp_path / "images.onnx")
    assert verifier.calibration == {"normal": pytest.approx(calibration["normal"])}
    for size in (1, 3):
        rows = slice(3, 3 + size)
        arrays = data.images[rows], data.features[rows], data.log_odds[rows]
        with torch.inference_mode():
            expected = run.network.eval()(*map(torch.from_numpy, arrays)).numpy()
        np.testing.assert_allclose(verifier.log_odds(*arrays), expected, atol=1e-4)


def test_an_interrupted_training_ends_with_the_same_weights(data, tmp_path):
    whole = Run(data, tmp_path / "whole", TINY)
    list(whole.go_on())
    next(Run(data, tmp_path / "parts", TINY).go_on())
    resumed = Run(data, tmp_path / "parts", TINY)
    assert [x.number for x in resumed.go_on()] == [2]
    for a, b in zip(whole.network.state_dict().values(), resumed.network.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b)
    with pytest.raises(ReorientError, match="another config"):
        Run(data, tmp_path / "parts", replace(TINY, lr=0.1))
    warm = Run(data, tmp_path / "warm", TINY, tmp_path / "whole" / "last.ckpt")
    torch.testing.assert_close(warm.network.last.weight, whole.network.last.weight)


def test_untrained_it_answers_like_the_trees(data):
    network = ImageNetwork(len(FEATURES))
    np.testing.assert_allclose(log_odds_of(network, data, np.arange(5)), data.log_odds[:15], atol=1e-6)


def test_sets_do_not_affect_each_other_and_neither_way_is_first(data):
    torch.manual_seed(0)
    network = ImageNetwork(len(FEATURES))
    torch.nn.init.normal_(network.last.weight)
    alone = np.concatenate([log_odds_of(network, data, np.array([i])) for i in (4, 7)])
    np.testing.assert_allclose(log_odds_of(network, data, np.array([4, 7])), alone, atol=1e-4)
    exchanged = replace(data, images=data.images[:, ::-1].copy())
    np.testing.assert_allclose(log_odds_of(network, exchanged, np.array([4, 7])), alone, atol=1e-4)
    assert np.ptp(alone - data.log_odds[data.rows(np.array([4, 7]))]) > 1e-3


def test_the_loss_counts_each_way_of_being_right():
    of, right = torch.tensor([0, 0, 1, 1]), torch.tensor([True, False, False, False])
    good = loss(torch.tensor([4.0, -4.0, -4.0, -4.0]), right, of, 2)
    assert good < 0.1
    assert loss(torch.tensor([-4.0, 4.0, -4.0, -4.0]), right, of, 2) > 4
    assert loss(torch.tensor([4.0, -4.0, 4.0, -4.0]), right, of, 2) > good + 0.9


def test_the_verb_trains_and_writes(data, tmp_path, monkeypatch):
    monkeypatch.setattr("reorient.learning.image_sets.read_sets", lambda folders, effort="normal": data)
    out, tiny = tmp_path / "images.onnx", ("--rounds", "1", "--steps", "1", "--held-out", "0.3")
    main(
        ["verifier", "images", str(tmp_path / "data"), "--run-folder", str(tmp_path / "run"), "--out", str(out), *tiny]
    )
    assert load_image_verifier(out).calibration.keys() == {"normal"}


def test_from_objects_to_sets(tmp_path):
    made = ("--count", "2", "--pairs", "2", "--per-shard", "1", "--effort", "fast", "--least-deg", "90")
    main(["verifier", "make", str(tmp_path / "data"), "--images", *made])
    sets = read_sets([tmp_path / "data"])
    assert len(sets) == len(set(sets.of.tolist())) >= 1
    assert sets.images.shape[1:] == (2, len(CHANNELS), SIZE, SIZE)
    assert set(sets.angle_deg.tolist()) == {90.0}
