"""The pose estimate from odometry, a gyro and external poses."""
