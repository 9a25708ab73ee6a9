"""Kind of trial: one image, one pose."""

from boresight.campaign.kinds.single_image.trial import SingleImage
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="single-image",
    version=2,
    block_trials=10,
    method_version=SingleImage.method_version,
    check_scenario=SingleImage.check_scenario,
    methods=SingleImage.methods,
    prepare=SingleImage.prepare,
    open=SingleImage.open,
    databases=True,
)
