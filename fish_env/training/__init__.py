"""Training, with the extra [train]: PPO of Stable-Baselines3, its runs, their files and their reports.

`config` has the settings of each task, `train` makes a run, `report_page` its page. torch, Stable-Baselines3 and
matplotlib are loaded by the modules that need them; `config` and `checkout` need none.
"""
