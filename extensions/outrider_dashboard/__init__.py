"""Show a run live in the browser, and control it.

One process with one session on the bus:

- `sources`: a live or a recorded run;
- `hub`: sends its newest state to the browsers; `chart_data` stores the data of the charts;
- `controls`: the interactive cards; `teleoperation` lets one browser at a time drive a UGV;
- `address`, `page_guard`: token, security headers, limits on requests;
- `shell`, `app`: layout of the page and the web server.

The files in `static` draw the pictures in the browser. The page loads nothing from other servers.
"""
