"""Compiled roll-outs are the game: the recorded games, step for step; and what happens after t0 is drawn anew."""

import numpy as np
import pytest

from learning.collect import NO_TRAJECTORIES, CollectSettings, play_block
from learning.convert import convert
from learning.dataset import Dataset, Samples
from learning.roll_outs import catch_steps, first_view, goal_paths, oracle_catch_steps, simulation_seeds, start_of
from learning.roll_outs.game import Lens, Minds, roll_out_game
from learning.roll_outs.outcomes import recorded_hider
from services.seeker.policy import PRESETS
from vantage.world.arena import ARENA_SIZE, GOALS
from vantage.world.camera import Camera

STEPS = 60
GAMES = 14


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("roll_outs")
    (folder / "logs").mkdir()
    generator = np.random.default_rng(4)
    recorded = tuple(generator.integers(1, 5, 90) for _ in range(3))
    for seeker in ("glancing", "expert"):
        for hider, seed in (("goal-walk", 1), ("random", 2001), ("replay", 4001)):
            settings = CollectSettings(hider=hider, seeker=seeker, seed=seed, steps=STEPS)  # type: ignore[arg-type]
            trajectories = (recorded, recorded, recorded) if hider == "replay" else NO_TRAJECTORIES
            play_block(settings, range(1, GAMES + 1), folder / "logs" / f"{hider}_{seeker}.mcap", trajectories)
    convert([folder / "logs"], folder / "set", workers=1, quiet=True)
    return Dataset(folder / "set")


def play_again(dataset: Dataset, row: int) -> tuple[int, np.ndarray]:
    start, goal, primitives = recorded_hider(dataset, row)
    track = np.full((STEPS + 1, 2, 3), np.nan)
    attention = PRESETS[dataset.episodes["seeker"][row].decode()]
    caught = roll_out_game(
        *(Lens.of(Camera()), start.boxes, ARENA_SIZE, ARENA_SIZE, start.poses, goal[0], goal[1], primitives, attention),
        *(start.catch_distance, STEPS, start.seed, 0, start.seed, Minds.empty(), track),
    )
    return caught, track


def test_a_roll_out_with_an_episodes_own_seed_is_that_episode(dataset: Dataset) -> None:
    caught_in_all = 0
    for row, episode in enumerate(dataset.episodes):
        caught, track = play_again(dataset, row)
        assert caught == episode["caught_step"], (row, episode)
        steps = dataset.steps[episode["first_step"] : episode["first_step"] + episode["steps"]]
        for index, robot in enumerate(("hider", "seeker")):
            assert np.allclose(track[: len(steps), index, 0], steps[robot]["x"], atol=1e-5)
            assert np.allclose(track[: len(steps), index, 1], steps[robot]["y"], atol=1e-5)
            turned = np.radians(10.0 * track[: len(steps), index, 2]) - steps[robot]["heading"]
            assert np.allclose(np.cos(turned), 1.0, atol=1e-6)
        caught_in_all += caught > 0
    assert len(dataset.episodes) == 6 * GAMES
    assert 0.2 * len(dataset.episodes) < caught_in_all < len(dataset.episodes)


def test_driving_to_a_goal_walks_goal_gives_its_outcome(dataset: Dataset) -> None:
    """What `catch_steps` says of the goal that a recorded hider drew is what happened to that hider."""
    checked = 0
    for row in np.flatnonzero(dataset.episodes["hider"] == b"goal-walk"):
        episode = dataset.episodes[row]
        start, goal, _ = recorded_hider(dataset, int(row))
        number = int(np.argmin(np.hypot(GOALS[:, 0] - goal[0], GOALS[:, 1] - goal[1])))
        caught = catch_steps(start, np.array([number]), np.array([start.seed]), episode["seeker"].decode(), STEPS)
        assert caught.tolist() == [[episode["caught_step"]]]
        goals, paths = goal_paths(start, STEPS - 1)
        plan = dataset.plans[dataset.steps["plan"][episode["first_step"]]]
        logged = dataset.positions[plan["first_position"] : plan["first_position"] + STEPS]
        assert np.allclose(paths[goals.tolist().index(number)][:STEPS, :2], logged[:, :2], atol=1e-5)
        view = np.frombuffer(dataset.image(int(episode["first_step"]), 0), np.uint8).reshape(128, 128)
        assert (first_view(start).image == view).all()
        checked += 1
    assert checked == 2 * GAMES


def test_the_oracle_knows_what_has_happened_and_draws_anew_what_has_not(dataset: Dataset) -> None:
    episodes = np.arange(len(dataset.episodes))
    caught_step = dataset.episodes["caught_step"].astype(np.int64)
    playing = np.where(caught_step >= 0, caught_step, STEPS).astype(np.int64)
    generator = np.random.default_rng(1)
    samples = dataset.draw("train", 40, generator, from_start=0.5, symmetries=1)
    caught = oracle_catch_steps(dataset, samples, simulations=6, workers=2)
    assert caught.shape == (40, 6)
    assert ((caught == -1) | (caught > samples.start[:, None])).all(), "nobody is caught before t0"
    assert (caught <= (samples.start + samples.horizon)[:, None]).all()
    assert (oracle_catch_steps(dataset, samples, simulations=6, workers=1) == caught).all()
    late = Samples(episodes[:20], playing[:20] - 1, np.ones(20, np.int64), np.zeros(20, np.int64), caught_step[:20] >= 0)
    one_step_on = oracle_catch_steps(dataset, late, simulations=3)
    decided = (one_step_on == playing[:20, None]).mean(axis=1) > 0.5
    assert (decided == (caught_step[:20] >= 0)).mean() > 0.8, "a step before its end a game is nearly decided"
    share = (caught >= 0).mean(axis=1)
    assert ((share > 0.5) == samples.caught).mean() > 0.7
    assert (caught != caught[:, :1]).any(), "the future is drawn anew"


def test_simulations_do_not_repeat_the_episodes_own_seed() -> None:
    start = start_of("random", 17)
    seeds = simulation_seeds(start.seed, 20)
    assert len(set(seeds.tolist()) | {start.seed}) == 21
    goals, _ = goal_paths(start, 10)
    caught = catch_steps(start, goals[:12], seeds, "glancing", 150)
    assert caught.shape == (12, 20)
    assert (caught.std(axis=1) > 0).any()


def test_a_hider_that_reacts_cannot_be_played_again(dataset: Dataset) -> None:
    dataset.episodes["hider"][0], kept = b"scripted", dataset.episodes["hider"][0]
    try:
        with pytest.raises(ValueError, match="reacts"):
            recorded_hider(dataset, 0)
    finally:
        dataset.episodes["hider"][0] = kept
