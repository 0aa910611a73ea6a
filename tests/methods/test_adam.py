import copy

import pytest
import torch

from anystyle.methods.adam import Adam


def parameters() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    shapes = {"centres": (7, 3), "opacities": (7,), "none": (7, 0, 3)}
    return {name: torch.randn(shape, generator=generator).requires_grad_() for name, shape in shapes.items()}


def give_gradients(values: dict[str, torch.Tensor], step: int) -> None:
    generator = torch.Generator().manual_seed(step)
    for name, value in values.items():
        gradient = torch.randn(value.shape, generator=generator)
        value.grad = None if (name, step) == ("opacities", 1) else gradient


RATES = {"centres": 0.1, "opacities": 0.02, "none": 0.3}


def test_steps_are_those_of_pytorch_to_the_bit():
    ours, theirs = parameters(), parameters()
    groups = [{"params": [value], "lr": RATES[name]} for name, value in theirs.items()]
    optimizer = torch.optim.Adam(groups, betas=(0.8, 0.95), eps=1e-15, fused=True)
    adam = Adam(ours, RATES, betas=(0.8, 0.95), eps=1e-15)
    for step in range(4):
        give_gradients(ours, step)
        give_gradients(theirs, step)
        adam.rates["centres"] = optimizer.param_groups[0]["lr"] = 0.1 / (1 + step)
        adam.step()
        optimizer.step()
    assert all(torch.equal(value, theirs[name]) for name, value in adam.parameters.items())
    assert all(value.grad is None for value in adam.parameters.values())


@pytest.mark.parametrize("restored", [False, True])
def test_rows_keep_their_moments_where_others_go_and_where_a_state_is_restored(restored):
    index = torch.tensor([5, 0, 0, 3])
    whole, part = Adam(parameters(), RATES), Adam(parameters(), RATES)
    for step in range(2):
        for adam in (whole, part):
            give_gradients(adam.parameters, step)
            adam.step()
    part.select(index)
    if restored:
        state, part = copy.deepcopy(part.state_dict()), Adam(parameters(), RATES)
        part.load_state_dict(state)
    give_gradients(whole.parameters, 2)
    for name, value in part.parameters.items():
        gradient = whole.parameters[name].grad
        assert gradient is not None
        value.grad = gradient[index].clone()
    whole.step()
    part.step()
    assert all(torch.equal(value, whole.parameters[name][index]) for name, value in part.parameters.items())
