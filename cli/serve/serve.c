/* citysplat serve: tile stores over HTTP, until SIGTERM or Ctrl-C. SIGHUP opens the stores again.
 * stdout gets one line, the address to open; everything else is log.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "cli/base/cli.h"
#include "cli/base/outcome.h"
#include "cli/base/output.h"
#include "core/trace.h"
#include "server/http/supervisor.h"
#include "server/server.h"

static const struct options_def serve_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct server_config, __VA_ARGS__)
#include "server/base/options.def"
};

static const struct options_spec serve_spec = {
    .command = "serve",
    .usage = "citysplat serve CITY.tiles|FOLDER|URL [MORE ...] [options]",
    .about =
        "Serves tile stores to map clients: Gaussian tiles as .glb, .spz, .drc and .ply, 3D "
        "Tiles and TileJSON descriptions, rendered views as .jpg, .png and .webp, and the "
        "viewer. A store is a file, each NAME.tiles of a folder, or an object at https://, http:// "
        "or s3:// that is read in parts. One that cannot be opened is left out and tried again. "
        "It listens on this machine only; --address changes that. For the internet use "
        "--tls-cert, or a proxy with TLS. SIGTERM finishes the running requests and exits. "
        "SIGHUP opens the stores again; the older revision is served for another day. --check "
        "tells whether it would start. Exit codes are those of sysexits.h: 64 options, 65 and "
        "66 stores, 69 port or device, 71 memory, 74 input and output, 78 a configuration file, "
        "--auth or --check.",
    .example = "citysplat serve city.tiles\n"
               "citysplat serve old-town.tiles harbour.tiles --address 0.0.0.0 --port 8000\n"
               "citysplat serve /var/lib/citysplat\n"
               "citysplat serve https://cdn.example/city.tiles --cache-dir /var/cache/citysplat\n"
               "citysplat serve s3://bucket/city.tiles",
    .defs = serve_defs,
    .n_defs = sizeof serve_defs / sizeof *serve_defs,
    .min_args = 1,
    .max_args = SIZE_MAX,
};

/* A line on stdout: for people as it is, as a line of a JSON log with that format. */
static void serve_say(const char *fmt, ...) ERR_PRINTF(1, 2);
static void serve_say(const char *fmt, ...)
{
    char text[400], quoted[600], now[32];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(text, sizeof text, fmt, ap);
    va_end(ap);
    log_now(now);
    log_quote(text, quoted, sizeof quoted);
    if (log_is_json())
        printf("{\"ts\":\"%s\",\"level\":\"info\",\"module\":\"serve\",\"msg\":\"%s\"}\n", now,
               quoted);
    else
        printf("%s\n", text);
    fflush(stdout);
}

/* Half of the time that the supervisor gives: say that the program answers, while it does. */
static void serve_watch(const struct server *sv, double *next_s)
{
    double every_s = supervisor_watchdog_s() / 2;
    if (every_s <= 0 || clock_s() < *next_s)
        return;
    if (server_answers(sv, every_s / 2))
        supervisor_well();
    else
        log_error("serve", "the program does not answer its own request");
    *next_s = clock_s() + every_s;
}

/* Until SIGTERM, or until pictures fail for too long and that is to end the program. */
static enum err_code serve_run(struct server *sv, const struct server_config *cfg,
                               const sigset_t *hup, struct err *e)
{
    double next_s = 0;
    server_keep(sv);
    while (!signals_stopping()) {
        const struct timespec wait = {.tv_nsec = 100000000};
        if (sigtimedwait(hup, NULL, &wait) == SIGHUP)
            server_ask_reload(sv);
        server_keep_memory(sv, clock_s());
        serve_watch(sv, &next_s);
        if (cfg->exit_hung && server_failing_s(sv) > fmax(cfg->device_timeout_s, 10))
            return err_set(e, ERR_DEVICE, "pictures have failed for %.0f s, and --exit-hung is set",
                           server_failing_s(sv));
    }
    return ERR_OK;
}

/* A server that is started again has the same options: it must not replace what a former one found.
 */
static enum err_code serve_trace_check(const char *path, struct err *e)
{
    enum err_code rc = output_check(path, true, e);
    if (!rc && file_exists(path))
        rc = err_set(e, ERR_ARG,
                     "--trace %s: exists, and serve replaces no trace: remove it, or name another "
                     "file",
                     path);
    const char *slash = strrchr(path, '/');
    char dir[FILE_PATH_MAX] = ".";
    if (slash)
        snprintf(dir, sizeof dir, "%.*s", slash == path ? 1 : (int)(slash - path), path);
    if (!rc && access(dir, W_OK))
        rc = err_errno(e, ERR_IO, "--trace %s: a trace cannot be written there", path);
    return rc;
}

/* The trace is written whatever ended the server. */
static void serve_trace_end(const char *path)
{
    struct trace_result t;
    struct err e = {0};
    if (trace_end(&t, &e))
        log_error("serve", "%s", e.msg);
    else
        log_info("serve", "trace %s: spans=%zu dropped=%zu seconds=%.1f cores=%.2f", path, t.spans,
                 t.dropped, t.seconds, t.cores);
}

enum err_code cli_serve(int argc, char **argv, struct err *e)
{
    struct server_config cfg;
    struct options_args args;
    struct arena arena = {0};
    struct server *sv = NULL;
    sigset_t hup;
    sigemptyset(&hup);
    sigaddset(&hup, SIGHUP);
    config_fix(&cfg);
    enum err_code rc = options_parse(&serve_spec, argc, argv, &cfg, &args, &arena, e);
    if (rc || args.done)
        goto out;
    log_set_json(cfg.log_format);
    if (cfg.trace)
        rc = serve_trace_check(cfg.trace, e);
    if (!rc && cfg.check)
        rc = server_check(&cfg, args.arg, args.n, stdout, e);
    if (rc || cfg.check)
        goto out;
    /* Threads inherit the mask, so SIGHUP waits for sigtimedwait below. */
    pthread_sigmask(SIG_BLOCK, &hup, NULL);
    signals_catch();
    if (cfg.trace)
        rc = trace_begin(cfg.trace, e);
    if (!rc)
        rc = server_start(&cfg, args.arg, args.n, &sv, e);
    if (rc)
        goto out;
    serve_say("citysplat serves %zu dataset%s: open %s", server_count(sv),
              server_count(sv) == 1 ? "" : "s", server_url(sv));
    if (cfg.admin)
        serve_say("operators: port %u", (unsigned)server_admin_port(sv));
    supervisor_ready("serving");
    rc = serve_run(sv, &cfg, &hup, e);
    supervisor_stopping();
    log_info("serve", "stopping: answers under way are finished first");
out:;
    const bool stopped = server_stop(&sv);
    if (trace_on())
        serve_trace_end(cfg.trace);
    if (!stopped) {
        fflush(stdout);
        /* not through the driver's own end, so not through main either */
        _exit(outcome_tell(serve_spec.command, rc, e, argc, argv));
    }
    arena_free(&arena);
    return rc;
}
