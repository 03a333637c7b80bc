"""Speed and trueness, measured by one command each; and the paper's figures made again."""
