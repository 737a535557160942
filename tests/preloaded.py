"""What a worker of the tests holds from the beginning: the stages, and their kernels loaded."""

from demflow.model.stages import STAGES
from tests.sweep import toy_stages

for stage in (*STAGES, *toy_stages.STAGES):
    _ = stage.run
