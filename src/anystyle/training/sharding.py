"""FSDP2: processes share out the weights that learn, with their gradients and the optimiser's averages."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.core.optimizer import LightningOptimizer
from lightning.pytorch.strategies import ModelParallelStrategy
from torch import nn
from torch.distributed.checkpoint.state_dict import (
    StateDictOptions,
    get_optimizer_state_dict,
    set_model_state_dict,
    set_optimizer_state_dict,
)
from torch.distributed.device_mesh import DeviceMesh
from torch.distributed.fsdp import fully_shard
from torch.distributed.tensor import DTensor
from torch.optim import Optimizer


class Sharded(ModelParallelStrategy):
    """Lightning's FSDP2 with one checkpoint file, the same as that of every other strategy.

    A checkpoint of one process continues on several and the other way round, for the file holds whole tensors. All
    processes of all nodes share in the data, each seeing its own part of a batch.
    """

    def setup_environment(self) -> None:
        """Only here the number of processes is known, however ``trainer.devices`` says it."""
        self._data_parallel_size, self._tensor_parallel_size = self.num_processes * self.num_nodes, 1
        super().setup_environment()

    def optimizer_state(self, optimizer: Optimizer) -> dict[str, Any]:
        """The whole state, with parameters by number as an optimiser has them; empty in all processes but the first."""
        module = self.lightning_module
        assert module is not None
        own = optimizer._optimizer if isinstance(optimizer, LightningOptimizer) else optimizer
        whole = StateDictOptions(full_state_dict=True, cpu_offload=True)
        state: Any = get_optimizer_state_dict(module, own, options=whole)
        if not state:
            return {}
        places = {name: place for place, name in enumerate(_order(module, own))}
        groups = [{**group, "params": [places[name] for name in group["params"]]} for group in state["param_groups"]]
        return {"state": {places[name]: value for name, value in state["state"].items()}, "param_groups": groups}

    def load_checkpoint(self, checkpoint_path: Any, weights_only: bool | None = None) -> dict[str, Any]:
        """Read the file in each process, and keep this process's share of it."""
        checkpoint = torch.load(Path(str(checkpoint_path)), map_location="cpu", weights_only=True, mmap=True)
        module = self.lightning_module
        assert module is not None
        # What is frozen is not in the file, and comes from the module itself.
        own = {key: value for key, value in module.state_dict().items() if not isinstance(value, DTensor)}
        whole = StateDictOptions(full_state_dict=True)
        set_model_state_dict(module, own | checkpoint["state_dict"], options=whole)
        for optimizer, state in zip(self.optimizers, checkpoint["optimizer_states"], strict=True):
            set_optimizer_state_dict(module, optimizer, _named(module, optimizer, state), options=whole)
        return checkpoint


def _order(module: nn.Module, optimizer: Optimizer) -> list[str]:
    """The names of an optimiser's parameters, in its order."""
    names = {id(parameter): name for name, parameter in module.named_parameters()}
    return [names[id(parameter)] for group in optimizer.param_groups for parameter in group["params"]]


def _named(module: nn.Module, optimizer: Optimizer, state: dict[str, Any]) -> dict[str, Any]:
    """An optimiser's state with parameters by name, where its file has them by number."""
    order = _order(module, optimizer)
    groups = [{**group, "params": [order[place] for place in group["params"]]} for group in state["param_groups"]]
    return {"state": {order[place]: value for place, value in state["state"].items()}, "param_groups": groups}


def shard(roots: Sequence[nn.Module], units: Sequence[nn.Module], mesh: DeviceMesh) -> None:
    """Share modules out among the processes of a mesh.

    Args:
        roots: What learns.
        units: Parts of them that are gathered one at a time, in order, as they are needed.
        mesh: One-dimensional.
    """
    for module in (*units, *roots):
        fully_shard(module, mesh=mesh)


def gathered(module: nn.Module) -> nn.Module:
    """A module whose state is the whole of that of a shared one; all processes take part. Others are returned as is."""
    state = module.state_dict()
    if not any(isinstance(value, DTensor) for value in state.values()):
        return module
    whole = {key: value.full_tensor() if isinstance(value, DTensor) else value for key, value in state.items()}
    shell = nn.Module()
    shell.register_state_dict_post_hook(lambda _, found, *rest: found.update(whole))
    return shell
