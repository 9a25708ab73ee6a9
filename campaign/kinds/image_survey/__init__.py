"""Kind of trial: the images of an arc, planned."""

from boresight.campaign.kinds.image_survey.trial import ImageSurvey
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="image-survey",
    version=1,
    block_trials=1,
    method_version=ImageSurvey.method_version,
    check_scenario=ImageSurvey.check_scenario,
    methods=ImageSurvey.methods,
    open=ImageSurvey.open,
)
