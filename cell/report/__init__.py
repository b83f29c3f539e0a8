"""Reports for people: tables, pages and pictures of plans and executions."""
