"""``config.yml`` of a run, as nerfstudio 1.1 reads it.

It is YAML that names nerfstudio's classes. What a class has as a plain default is left out; what it makes anew for
each instance has to be there.
"""

import json
from pathlib import Path

_TEXT = """\
!!python/object:nerfstudio.engine.trainer.TrainerConfig
_target: !!python/name:nerfstudio.engine.trainer.Trainer ''
data: null
experiment_name: {experiment}
gradient_accumulation_steps: {{}}
logging: !!python/object:nerfstudio.configs.base_config.LoggingConfig
  local_writer: !!python/object:nerfstudio.configs.base_config.LocalWriterConfig
    enable: true
machine: !!python/object:nerfstudio.configs.base_config.MachineConfig
  seed: 42
max_num_iterations: 30000
method_name: splatfacto
optimizers: {{}}
output_dir: !!python/object/apply:pathlib.Path
- {output}
pipeline: !!python/object:nerfstudio.pipelines.base_pipeline.VanillaPipelineConfig
  _target: !!python/name:nerfstudio.pipelines.base_pipeline.VanillaPipeline ''
  datamanager: !!python/object:nerfstudio.data.datamanagers.full_images_datamanager.FullImageDatamanagerConfig
    _target: !!python/name:nerfstudio.data.datamanagers.full_images_datamanager.FullImageDatamanager ''
    cache_images: cpu
    cache_images_type: uint8
    dataparser: !!python/object:nerfstudio.data.dataparsers.nerfstudio_dataparser.NerfstudioDataParserConfig
      _target: !!python/name:nerfstudio.data.dataparsers.nerfstudio_dataparser.Nerfstudio ''
      auto_scale_poses: false
      center_method: none
      data: &data !!python/object/apply:pathlib.Path
      - {data}
      downscale_factor: 1
      eval_mode: all
      load_3D_points: true
      orientation_method: none
    data: *data
  model: !!python/object:nerfstudio.models.splatfacto.SplatfactoModelConfig
    _target: !!python/name:nerfstudio.models.splatfacto.SplatfactoModel ''
    background_color: white
    camera_optimizer: !!python/object:nerfstudio.cameras.camera_optimizers.CameraOptimizerConfig
      _target: !!python/name:nerfstudio.cameras.camera_optimizers.CameraOptimizer ''
      mode: 'off'
    collider_params:
      far_plane: 6.0
      near_plane: 2.0
    loss_coefficients:
      rgb_loss_coarse: 1.0
      rgb_loss_fine: 1.0
    num_downscales: 0
    sh_degree: {degree}
timestamp: {run}
viewer: !!python/object:nerfstudio.configs.base_config.ViewerConfig
  quit_on_train_completion: false
vis: viewer
"""


def config_text(output: Path, data: Path, *, experiment: str, run: str, degree: int) -> str:
    """The configuration of a run in ``output/experiment/splatfacto/run`` on data whose coordinates are the model's."""
    quoted = {name: json.dumps(value) for name, value in (("experiment", experiment), ("run", run))}
    paths = {name: json.dumps(str(path)) for name, path in (("output", output), ("data", data))}
    return _TEXT.format(**quoted, **paths, degree=degree)
