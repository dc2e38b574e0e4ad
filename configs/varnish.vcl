# citysplat behind Varnish 7: a memory cache over three servers that merges requests, answers stale while it asks
# again and when no server is left, and purges by tag. TLS belongs in front of it (hitch, nginx): tell the servers the
# address that clients see (`serve --public-url https://...`), or links in documents begin with http.
#
#   varnishd -a :80 -a purge=127.0.0.1:8079 -f varnish.vcl -s malloc,4g -p http_gzip_support=off
#
# Purges have a port of their own, which no terminator of TLS passes on to. Purge a dataset, or one revision, with
# `serve --tag-header xkey` (Debian's varnish-modules has the vmod):
#   curl -X PURGE -H 'xkey-purge: ds-city' http://127.0.0.1:8079/
#   curl -X PURGE -H 'xkey-purge: rev-0123456789ab' http://127.0.0.1:8079/
vcl 4.1;

import directors;
import std;
import xkey;

probe ready {
    .url = "/readyz";
    .interval = 1s;
    .timeout = 1s;
    .window = 3;
    .threshold = 2;
    .initial = 2;
}
backend a { .host = "127.0.0.1"; .port = "8081"; .probe = ready; }
backend b { .host = "127.0.0.1"; .port = "8082"; .probe = ready; }
backend c { .host = "127.0.0.1"; .port = "8083"; .probe = ready; }

sub vcl_init {
    # Each tile is kept on one server; when one goes, the tiles of the others stay where they are.
    new servers = directors.shard();
    servers.add_backend(a);
    servers.add_backend(b);
    servers.add_backend(c);
    servers.reconfigure(67);
}

sub vcl_recv {
    if ((req.method == "PURGE") != (local.socket == "purge")) {
        return (synth(405));
    }
    if (req.method == "PURGE") {
        if (!req.http.xkey-purge) {
            return (purge);
        }
        set req.http.n = xkey.purge(req.http.xkey-purge);
        return (synth(200, req.http.n + " purged"));
    }
    if (req.url ~ "^/metrics") {
        return (synth(404));
    }
    # CesiumJS adds ?v= to every address: the server does not read it.
    set req.url = regsub(regsuball(req.url, "([?&])(v=[^&]*(&|$))+", "\1"), "[?&]$", "");
    unset req.http.X-Forwarded-Host;
    set req.backend_hint = servers.backend(by = URL);
    # While a server is there, nobody gets a document of a revision that it does not keep any more (--keep-s).
    if (std.healthy(req.backend_hint)) {
        set req.grace = 10m;
    }
    # Streams of pictures go through as they come.
    if (req.url ~ "^(/signed/[^/]+)?/d/[^/]+/motion/") {
        return (pipe);
    }
    if (req.method != "GET" && req.method != "HEAD") {
        return (pass);
    }
    # An answer for one who said who asks does not go to others (serve --auth).
    if (req.http.Authorization || req.http.Cookie ~ "(^|; *)citysplat=") {
        return (pass);
    }
    unset req.http.Cookie;
    return (hash);
}

sub vcl_backend_response {
    # Answered when no server is left, and for that kept a day beyond its time.
    set beresp.grace = 24h;
    set beresp.keep = 24h;
    # A server that fails does not take the place of an answer that is still there.
    if (beresp.status >= 500 && bereq.is_bgfetch) {
        return (abandon);
    }
    # For ten seconds, requests for what is not kept do not wait for each other.
    if (beresp.status >= 500 || beresp.http.Cache-Control ~ "(private|no-store)") {
        set beresp.uncacheable = true;
        set beresp.ttl = 10s;
        set beresp.grace = 0s;
    }
}

sub vcl_backend_fetch {
    # One of three has just gone, and the probe has not seen it yet: the next one is asked.
    if (bereq.retries > 0) {
        set bereq.backend = servers.backend(by = URL, alt = bereq.retries);
    }
}

sub vcl_backend_error {
    if (bereq.retries < 2) {
        return (retry);
    }
}

sub vcl_deliver {
    if (obj.hits > 0) {
        set resp.http.X-Cache = "HIT";
    } else {
        set resp.http.X-Cache = "MISS";
    }
}
