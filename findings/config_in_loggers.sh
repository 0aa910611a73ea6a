#!/usr/bin/env bash
# A Hydra config in four loggers of Lightning 2.6.6: three keep what it says, Weights & Biases the words of its nodes.
#
# `log_hyperparams(cfg)` of a DictConfig {lr: 1e-5, ratio: ${lr}, layers: [1, 2, 3], loss: {style: {weight: ${lr}}}}:
#   CSVLogger, TensorBoardLogger    hparams.yaml has numbers and lists, interpolations resolved
#   MLFlowLogger (3.17.2)           "loss/style/weight": "1e-05"
#   WandbLogger (wandb 0.31.0)      loss is the string "{'style': {'weight': '${lr}'}}", layers the string "[1, 2, 3]";
#                                   lr and ratio, of the first level, are numbers. NaN becomes None
# A sweep is then neither filtered nor grouped by `loss.style.weight`. No warning. `wandb.init(config=cfg)` raises a
# TypeError. OmegaConf.to_container(cfg, resolve=True) gives all four the same.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 lightning==2.6.6 omegaconf==2.3.0 tensorboard==2.21.0 wandb==0.31.0 \
    mlflow-skinny==3.17.2 sqlalchemy==2.1.9 alembic==1.20.1 numpy==2.4.6 setuptools==80.9.0
WANDB_MODE=offline WANDB_SILENT=true env/bin/python - 2> log.txt <<'PYTHON'
import warnings
from pathlib import Path

import mlflow
import wandb
import yaml
from lightning.pytorch.loggers import CSVLogger, MLFlowLogger, TensorBoardLogger, WandbLogger
from omegaconf import OmegaConf

text = "{lr: 1e-5, ratio: '${lr}', layers: [1, 2, 3], empty: .nan, loss: {style: {weight: '${lr}'}}}"
config = OmegaConf.create(text)
plain = OmegaConf.to_container(config, resolve=True)
assert plain["loss"]["style"]["weight"] == 1e-5 and plain["layers"] == [1, 2, 3]

with warnings.catch_warnings():
    warnings.simplefilter("error", UserWarning)
    for logger in (CSVLogger("."), TensorBoardLogger(".")):
        logger.log_hyperparams(config)
        logger.save()
        read = yaml.safe_load(Path(logger.log_dir, "hparams.yaml").read_text())
        print(type(logger).__name__, read)
        assert {key: read[key] for key in ("lr", "ratio", "layers", "loss")} == {
            key: plain[key] for key in ("lr", "ratio", "layers", "loss")
        }
    for given in (config, plain):
        logger = WandbLogger(project="study", offline=True, save_dir=".")
        logger.log_hyperparams(given)
        read = dict(logger.experiment.config)
        wandb.finish()
        print("WandbLogger", read)
        assert read["lr"] == read["ratio"] == 1e-5 and read["empty"] is None
        if given is plain:
            assert read["loss"] == {"style": {"weight": 1e-5}} and read["layers"] == [1, 2, 3]
        else:
            assert read["loss"] == "{'style': {'weight': '${lr}'}}" and read["layers"] == "[1, 2, 3]"
try:
    wandb.init(project="study", dir=".", config=config)
except TypeError as error:
    print("wandb.init:", error)
else:
    raise AssertionError("wandb.init")

store = "sqlite:///runs.db"
logger = MLFlowLogger("study", tracking_uri=store)
logger.log_hyperparams(config)
read = mlflow.MlflowClient(store).get_run(logger.run_id).data.params
print("MLFlowLogger", read)
assert read["loss/style/weight"] == read["ratio"] == "1e-05" and read["layers"] == "[1, 2, 3]"
PYTHON
echo "as described"
