"""Plans against linear programs, and the loss against nearest neighbours."""

import math

import pytest
import torch
from scipy.optimize import linprog
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.testing.oracle import smooth_image
from anystyle_methods.nnfm import NNFM
from anystyle_methods.optimal_transport import OptimalTransport, transport_plan
from tests.support.style_cases import stylization

RENDERED, PHOTOGRAPHS = smooth_image(21, [1, 2, 3, 40, 48]), smooth_image(22, [1, 2, 3, 40, 48])
STYLE = smooth_image(23, [1, 3, 48, 40])
LAYERS = ("relu2_1",)


def costs(rows: int, columns: int) -> Tensor:
    return torch.rand(rows, columns, generator=torch.Generator().manual_seed(rows), dtype=torch.float64)


@pytest.mark.parametrize("capacity", [1.0, 1.5, 3.0])
def test_a_plan_is_the_linear_program_s(capacity: float) -> None:
    rows, columns = 6, 9
    cost = costs(rows, columns)
    from_rows = torch.eye(rows).repeat_interleave(columns, 1)
    to_columns = torch.eye(columns).repeat(1, rows)
    exact = linprog(
        cost.flatten().numpy(), to_columns.numpy(), [capacity / columns] * columns, from_rows.numpy(), [1 / rows] * rows
    )
    plan = transport_plan(cost, capacity, 5e-4, 5000)
    assert float((plan * cost).sum()) == pytest.approx(exact.fun, abs=2e-3)
    torch.testing.assert_close(plan.sum(1), torch.full((rows,), 1 / rows).double())
    assert plan.sum(0).max() <= capacity / columns * 1.01


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("iterations", [1, 7, 50])
def test_factors_are_steps_of_the_logarithmic_domain(iterations: int, dtype: torch.dtype) -> None:
    cost, epsilon, capacity = costs(60, 40), 0.01, 1.3
    kernel, column = -cost / epsilon, torch.zeros(40, dtype=torch.float64)
    for _ in range(iterations):
        row = -(kernel + column).logsumexp(1)
        column = (math.log(capacity * 60 / 40) - (kernel + row[:, None]).logsumexp(0)).clamp_max(0)
    expected = (kernel + column).softmax(1) / 60
    plan = transport_plan(cost.to(dtype), capacity, epsilon, iterations)
    atol = 1e-12 if dtype == torch.float64 else 2e-6
    torch.testing.assert_close(plan.double(), expected, rtol=0, atol=atol)


def test_a_plan_has_no_denormal_numbers() -> None:
    plan = transport_plan(2 * costs(60, 40).float(), 1.3, 0.01, 50)
    assert 1e-35 < plan.min() < 1e-30


def test_without_a_limit_it_is_nearest_neighbours() -> None:
    options = {"network": "texture", "layers": LAYERS, "size": None}
    result = stylization(RENDERED, PHOTOGRAPHS, STYLE)
    transport = OptimalTransport(**options, capacity=1e6, epsilon=1e-5, num_samples=10**6)
    torch.testing.assert_close(transport(result), NNFM(**options)(result), rtol=1e-4, atol=1e-6)


def test_a_limit_spreads_matches_and_a_sample_stands_for_all() -> None:
    options = {"network": "texture", "layers": LAYERS, "size": None}
    result = stylization(RENDERED, PHOTOGRAPHS, STYLE)
    nearest, loose, tight = (
        float(OptimalTransport(**options, capacity=capacity, num_samples=10**6)(result)) for capacity in (1e6, 2.0, 1.0)
    )
    assert nearest < loose < tight
    torch.manual_seed(0)
    sampled = OptimalTransport(**options, num_samples=128)
    mean = sum(float(sampled(result)) for _ in range(20)) / 20
    assert mean == pytest.approx(loose, rel=0.2)


@pytest.mark.parametrize("wrong", [{"capacity": 0.5}, {"epsilon": 0.0}, {"iterations": 0}, {"num_samples": 0}])
def test_numbers_out_of_range_are_told(wrong: dict[str, float]) -> None:
    with pytest.raises(UserError, match=next(iter(wrong))):
        build(Loss, {"_target_": f"{OptimalTransport.__module__}.OptimalTransport", **wrong})
