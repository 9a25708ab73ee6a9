"""Vision layer of sequences: images, known attitude and predicted motion in, tracks out."""
