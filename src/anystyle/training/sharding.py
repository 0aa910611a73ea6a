"""FSDP2: trainable weights, their gradients and the optimiser's state are sharded over the processes."""

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
    """Lightning's FSDP2 with the checkpoint file of every other strategy: a run may change its number of processes.

    The file holds full tensors, and the optimiser's state in the optimiser's own order. (Lightning's single file counts
    frozen parameters too, and does not load without them.)
    """

    def setup_environment(self) -> None:
        # Only here the number of processes is known, however ``trainer.devices`` says it.
        self._data_parallel_size, self._tensor_parallel_size = self.num_processes * self.num_nodes, 1
        super().setup_environment()

    def optimizer_state(self, optimizer: Optimizer) -> dict[str, Any]:
        module = self.lightning_module
        assert module is not None
        raw = optimizer._optimizer if isinstance(optimizer, LightningOptimizer) else optimizer
        state: Any = get_optimizer_state_dict(
            module, raw, options=StateDictOptions(full_state_dict=True, cpu_offload=True)
        )
        if not state:
            return {}
        return _rekeyed(state, {name: index for index, name in enumerate(_names(module, raw))})

    def load_checkpoint(self, checkpoint_path: Any, weights_only: bool | None = None) -> dict[str, Any]:
        checkpoint = torch.load(Path(str(checkpoint_path)), map_location="cpu", weights_only=True, mmap=True)
        module = self.lightning_module
        assert module is not None
        # Frozen weights are not in the file, and come from the module itself.
        frozen = {key: value for key, value in module.state_dict().items() if not isinstance(value, DTensor)}
        full_state = StateDictOptions(full_state_dict=True)
        set_model_state_dict(module, frozen | checkpoint["state_dict"], options=full_state)
        for optimizer, state in zip(self.optimizers, checkpoint["optimizer_states"], strict=True):
            named = _rekeyed(state, dict(enumerate(_names(module, optimizer))))
            set_optimizer_state_dict(module, optimizer, named, options=full_state)
        return checkpoint


def _names(module: nn.Module, optimizer: Optimizer) -> list[str]:
    """The names of an optimiser's parameters, in its order."""
    names = {id(parameter): name for name, parameter in module.named_parameters()}
    return [names[id(parameter)] for group in optimizer.param_groups for parameter in group["params"]]


def _rekeyed(state: dict[str, Any], new: dict[Any, Any]) -> dict[str, Any]:
    """An optimiser's state with other keys for its parameters: indices for names, or names for indices."""
    groups = [{**group, "params": [new[key] for key in group["params"]]} for group in state["param_groups"]]
    return {"state": {new[key]: value for key, value in state["state"].items()}, "param_groups": groups}


def shard(roots: Sequence[nn.Module], units: Sequence[nn.Module], mesh: DeviceMesh) -> None:
    """Shard trainable modules over a one-dimensional mesh; units are gathered one at a time, in order."""
    for module in (*units, *roots):
        fully_shard(module, mesh=mesh)


def with_full_state(module: nn.Module) -> nn.Module:
    """A module whose state dict is the full one of a sharded module; collective. Other modules are returned as is."""
    state = module.state_dict()
    if not any(isinstance(value, DTensor) for value in state.values()):
        return module
    full_state = {key: value.full_tensor() if isinstance(value, DTensor) else value for key, value in state.items()}
    shell = nn.Module()
    shell.register_state_dict_post_hook(lambda _, state_dict, *rest: state_dict.update(full_state))
    return shell
