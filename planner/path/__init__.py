"""Free paths between configurations, certified between the points that were checked."""
