"""Kind of trial: the images of an arc, planned."""

from boresight.campaign.kinds.image_survey.trial import ImageSurvey

KIND = ImageSurvey
