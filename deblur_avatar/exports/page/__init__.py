"""Avatar page: one HTML file that poses, sorts and draws an avatar in any browser."""
