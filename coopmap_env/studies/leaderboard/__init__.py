"""Results that anyone can score again: submissions with all actions, and a page that ranks them.

``coopmap submit`` plays a policy on the test worlds of a family and writes a submission;
``coopmap score`` replays submissions and computes every score again; see docs/leaderboard.md.
"""
