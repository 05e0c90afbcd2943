"""What an arm is, which closed form it has, where its tool goes; files that describe arms."""
