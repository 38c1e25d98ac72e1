"""The paper's searches, their loop and estimates, and the training of PPO and A2C."""
