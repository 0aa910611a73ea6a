"""What several processes compute for their rows is what one computes for all, in whatever mode."""

from dataclasses import replace

import pytest
import torch
import torch.distributed as dist

from anystyle.registry.catalog import catalog
from anystyle.testing.inputs import style_encoder, stylization
from anystyle.testing.subject import subject
from anystyle.types.seeds import seeded


def row(result, index):
    style = result.style
    style = replace(style.row(index), text=style.text[index : index + 1], names=style.names[index : index + 1])
    return replace(result.row(index), style=style)


@pytest.mark.parametrize("name", catalog().names("loss"))
def test_the_mean_of_two_processes_is_the_loss_of_one(name, monkeypatch):
    tested = subject("loss", catalog().find("loss", name).load())
    loss, result = tested.build(style_encoder=style_encoder()), stylization(2, 2).detach()
    with seeded(0):
        whole = loss(result)
    monkeypatch.setattr(dist, "is_initialized", lambda: True)
    monkeypatch.setattr(dist, "get_world_size", lambda: 2)
    values = []
    for rank in range(2):
        monkeypatch.setattr(dist, "get_rank", lambda rank=rank: rank)
        with seeded(0):
            values.append(loss(row(result, rank)))
    torch.testing.assert_close(torch.stack(values).mean(), whole, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", catalog().names("loss"))
def test_a_loss_may_be_looked_at_in_inference_mode_before_and_between_steps(name):
    tested = subject("loss", catalog().find("loss", name).load())
    loss, result = tested.build(style_encoder=style_encoder()), stylization(1, 2)
    with torch.inference_mode(), seeded(0):
        looked = loss(result)
    with seeded(0):
        value = loss(result)
    value.backward()
    torch.testing.assert_close(looked, value)
