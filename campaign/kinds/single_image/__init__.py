"""Kind of trial: one image, one pose."""

from boresight.campaign.kinds.single_image.trial import SingleImage

KIND = SingleImage
