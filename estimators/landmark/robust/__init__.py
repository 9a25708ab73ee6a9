"""Recognition by consensus: all corners are candidates, and the most probable pose of all that the prior admits wins.

Rowell et al. (2015), section 6, propose to consider every corner within the matching radius and to choose among all
possible matches by RANSAC. Here the prior bounds the pose so well that hypotheses need not come from random minimal
sets, of which hardly one in ten thousand would be free of false matches: they are laid out over the prior itself, and
each is scored, as in MLESAC (Torr and Zisserman 2000), by the likelihood of all corners.
"""
