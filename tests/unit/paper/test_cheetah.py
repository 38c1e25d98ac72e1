"""The half-cheetah written out, against MuJoCo's."""

import mujoco
import numpy as np
import pytest

from sim.paper.agents import build_agent
from sim.paper.arena import Arena, draw_seeds
from sim.paper.cheetah import step_cheetah
from sim.paper.cheetah_model import cheetah_work, load_cheetah
from sim.paper.mujoco_plants import MujocoPool
from sim.paper.plants import allocate_plants, observe, reset_plant, step_plant
from sim.paper.tasks import TASKS

TASK = TASKS["half-cheetah"]
KIND, STEP_S, FRAMES = TASK.stand_in


@pytest.fixture(scope="module")
def pool():
    return MujocoPool(TASK.mujoco.file, TASK.mujoco.frames, 1)


@pytest.fixture(scope="module")
def cheetah():
    return load_cheetah(TASK.mujoco.file)


def test_a_step_is_mujocos_wherever_the_cheetah_lies_and_however_it_moves(pool, cheetah):
    model, [data] = pool.model, pool.data
    assert (model.opt.timestep, pool.lanes.frames) == (STEP_S, FRAMES)
    work = cheetah_work()
    rng = np.random.default_rng(0)
    limits, contacts = 0, 0
    for _ in range(3000):
        mujoco.mj_resetData(model, data)
        data.qpos[:2] = rng.uniform(-3, 3), rng.uniform(-0.7, 0.3)
        data.qpos[2:] = rng.normal(0.0, (3.0, *[0.5] * 6))
        data.qvel[:] = rng.normal(0.0, 3.0, 9)
        data.ctrl[:] = rng.uniform(-1.0, 1.0, 6)
        work.position[:], work.velocity[:] = data.qpos, data.qvel
        step_cheetah(cheetah, work, STEP_S, data.ctrl[:, None].copy(), 0)
        mujoco.mj_step(model, data)
        limits += data.nefc > 4 * data.ncon
        contacts += data.ncon > 2
        # What is left is what MuJoCo's solver, at its tolerance, has not yet solved.
        np.testing.assert_allclose(work.velocity, data.qvel, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(work.position, data.qpos, rtol=1e-8, atol=1e-8)
    assert limits > 1000
    assert contacts > 500


def test_each_step_of_an_episode_is_mujocos(pool, cheetah):
    [data] = pool.data
    written = allocate_plants(KIND, 3, step_s=STEP_S, frames=FRAMES, cheetah=cheetah)
    mujocos = allocate_plants(TASK.plant, 1, 0.0, pool.lanes)
    start = TASK.start(np.random.default_rng(1))
    reset_plant(written, 1, start)
    reset_plant(mujocos, 0, start)
    rng = np.random.default_rng(2)
    for action in np.repeat(rng.uniform(-1.0, 1.0, (50, 6)), 4, axis=0):
        got = step_plant(written, 1, np.tile(action[:, None], 3))
        expected = step_plant(mujocos, 0, action[:, None].copy())
        assert got == (pytest.approx(expected[0], abs=1e-6), 0.0, False)
        seen, observed = np.zeros((17, 3)), np.zeros((17, 1))
        observe(written, 1, seen)
        observe(mujocos, 0, observed)
        np.testing.assert_allclose(seen[:, 1], observed[:, 0], rtol=0, atol=1e-6)
        # A rolling cheetah is chaotic: what a solver leaves undone would grow from step to step.
        written.state[:, 1] = np.concatenate([data.qpos, data.qvel])


def test_what_an_episode_gives_depends_on_no_other():
    agent = build_agent(TASK, "mlp", 0)
    vectors = np.random.default_rng(3).normal(0.0, 0.7, (8, agent.layout().size))
    seeds = draw_seeds(0, (1,), len(vectors))
    together = Arena(TASK, agent, 3, rough=True).run(vectors, seeds)
    alone = Arena(TASK, agent, 1, rough=True)
    again = [alone.run(vectors[[i]], seeds[[i]])[0] for i in reversed(range(len(seeds)))]
    np.testing.assert_array_equal(together, again[::-1])
