"""Files of users: logs of a vehicle and runs for its slip, as CSV."""
