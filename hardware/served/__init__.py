"""The simulated bench, served as a da Vinci research kit: the same topics, rejections and silent behaviours, on a real graph."""
