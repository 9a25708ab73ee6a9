"""The vision layer of sequences: images in, tracks out. It sees images, known attitude and predicted motion alone."""
