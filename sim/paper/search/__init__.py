"""The paper's searches, and the training of PPO and A2C."""
