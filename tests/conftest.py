"""One precision per process: TAICHI_SIM_PRECISION is f32 or f64 (left out: f64). Everything in a process shares its Taichi."""

import os

import pytest
from physics_support import PRECISION

# What knows nothing of precision: where both are run one after the other, once is enough, in single precision.
ONCE = (
    "bench",
    "camera",
    "cli",
    "intersections",
    "demos",
    "cloth_material",
    "atomic_file",
    "level_set",
    "surface_files",
    "mesh",
    "frame",
    "orbit",
    "outputs",
    "readme",
    "render",
    "report",
    "resume",
    "rooms",
    "scene",
    "scene_file",
    "shapes",
    "embedded_surfaces",
    "jelly_material",
    "surfaces",
    "tune",
    "spring_batches",
    "window",
)
ONCE_FILES = {f"test_{name}.py" for name in ONCE}
# Long ones that tell most in double precision, or the same in both: in single precision `make test-slow` runs them.
LONG = (
    "accuracy",
    "contact_energy",
    "elements",
    "hard_cases",
    "spatial_sort",
    "article",
    "brute_force",
    "colliders",
    "balls_and_sticks",
    "drivers",
    "triangle_pairs",
    "materials",
    "neighbours",
    "stiff",
    "swept",
    "thrown",
    "walls",
    "probes",
    "stability",
    "tolerance",
    "statistical_mechanics",
)
LONG_FILES = {f"test_{name}.py" for name in LONG}
# And long ones for which single precision is enough: in double precision `make test-slow` runs them.
LONG_ONCE = (
    "statistics",
    "collision_groups",
    "pins_and_tearing",
    "arguments",
    "piles",
    "simulation",
    "pointer",
    "checkpoint",
    "energy_monitor",
)
LONG_ONCE_FILES = {f"test_{name}.py" for name in LONG_ONCE}

# Twins of tests that run anyway, in another dimension or driver, and take long because they compile: `make test-slow` runs them.
# `*` stands for anything.
TWINS = (
    "test_probes.py::test_walls_and_colliders_receive_all_that_balls_lose[*",
    "test_spatial_sort.py::test_a_pile_moves_the_same_in_either_order[2d]",
    "test_article.py::test_row_10_push_out_gives_no_speed[2d]",
    "test_article.py::test_row_11_coincident_balls_have_a_direction[2d]",
    "test_article.py::test_row_4_stick_keeps_momentum_and_energy[2d]",
    "test_article.py::test_row_8_many_contacts_share_the_mass[2d]",
    "test_balls_and_sticks.py::test_a_dense_crowd_never_gains_energy[3d-symplectic_euler-",
    "test_balls_and_sticks.py::test_an_elastic_gas_in_a_box_keeps_its_energy[explicit_euler]",
    "test_balls_and_sticks.py::test_stack_of_10[3d-atomic-parallel]",
    "test_balls_and_sticks.py::test_stick_hits_of_any_masses[2d-ordered-parallel]",
    "test_balls_and_sticks.py::test_worked_stick_numbers[2d-",
    "test_balls_and_sticks.py::test_worked_stick_numbers[3d-atomic-parallel]",
    "test_drivers.py::test_atomic_agrees_with_ordered_in_a_pile[3d]",
    "test_drivers.py::test_pile_has_the_same_bits_in_both_drivers_and_every_run[2d-gauss_seidel]",
    "test_long_motion.py::test_damped_chain_comes_to_its_stretch[2d]",
    "test_neighbours.py::test_a_short_lever_does_not_throw_a_stick[2d]",
    "test_orders.py::test_order_f64[*-explicit_euler-3d]",
    "test_orders.py::test_order_f64[*-implicit_euler-3d]",
    "test_orders.py::test_order_f64[*-rk4-3d]",
    "test_orders.py::test_order_f64[*-tr_bdf2-3d]",
    "test_orders.py::test_order_f64[*-xpbd-3d]",
    "test_orders.py::test_order_of_verlet_with_weak_damping_f64[*-3d]",
    "test_swept.py::test_a_ball_before_the_wall_is_hit_and_not_run_through_twice[ordered-parallel]",
    "test_swept.py::test_a_bullet_leaves_the_stick_that_it_hit[2d]",
    "test_swept.py::test_a_bullet_that_bounces_off_a_collider_meets_what_lies_behind[beside_one_that_moves]",
    "test_swept.py::test_bullets_of_ten_radii_a_step_hit[2d]",
    "test_pointer.py::test_a_cloth_of_any_mass_hangs_from_the_hand[implicit_euler",
    "test_limits.py::test_no_advised_step_blows_up[rk4",
)


def _is_twin(nodeid):
    return any(all(part in nodeid for part in twin.split("*")) for twin in TWINS)


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config, items):
    for item in items:
        long = item.path.name in (LONG_FILES if PRECISION == "f32" else LONG_ONCE_FILES)
        if long or _is_twin(item.nodeid):
            item.add_marker(pytest.mark.slow)
    if os.environ.get("TAICHI_SIM_PRECISION") == "f64":
        again = [item for item in items if item.path.name in ONCE_FILES]
        config.hook.pytest_deselected(items=again)
        items[:] = [item for item in items if item.path.name not in ONCE_FILES]


@pytest.fixture(scope="session", autouse=True)
def _taichi():
    """Taichi on the CPU in this process's precision."""
    from taichi_sim.device import backend

    backend.start(arch="cpu", precision=PRECISION)


@pytest.fixture(scope="session")
def precision():
    """f32 or f64: what this process runs."""
    return PRECISION
