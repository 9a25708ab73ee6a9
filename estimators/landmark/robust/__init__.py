"""Recognition by consensus: the pose of greatest posterior probability, with all corners as candidate matches.

Rowell et al. (2015), section 6, propose to consider every corner within the matching radius and to choose among all
possible matches by RANSAC. Hardly one in ten thousand random minimal sets is free of false matches here, but the prior
bounds the pose well: hypotheses are therefore laid out on a grid over the prior, and each is scored, as in MLESAC (Torr
and Zisserman 2000), by the likelihood of all corners.
"""
