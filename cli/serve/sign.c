/* citysplat sign: signed addresses of a server with --auth, for clients that cannot send a token.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "cli/base/cli.h"
#include "server/access/auth.h"
#include "server/answers/routes.h"
#include "server/documents/link.h"
#include "server/route/router.h"

struct sign_config {
#define OPT OPTIONS_MEMBER
#include "cli/serve/sign.def"
};

static const struct options_def sign_defs[] = {
#define OPT(...) OPTIONS_ROW(struct sign_config, __VA_ARGS__)
#include "cli/serve/sign.def"
};

static const struct options_spec sign_spec = {
    .command = "sign",
    .usage = "citysplat sign NAME|PATH... --auth FILE [options]",
    .about = "Prints signed addresses for a server that was started with --auth. Of a dataset's "
             "NAME it prints an address that stands for the server's own: below it lie the viewer "
             "and every path of the dataset. Of a PATH, a tile or a picture, it prints the address "
             "that opens this path with this query alone. Such a path has the revision, as the "
             "addresses in the dataset's documents have it: /d/NAME/r/REV/... An address opens "
             "what it says until its time is over.",
    .example = "citysplat sign city --auth auth.jsonc --for-s 86400 --url https://maps.example\n"
               "citysplat sign /d/city/r/0123456789ab/static/8.68,50.11,260@10,-30/640x480.jpg "
               "--auth auth.jsonc",
    .defs = sign_defs,
    .n_defs = sizeof sign_defs / sizeof *sign_defs,
    .min_args = 1,
    .max_args = 16,
};

/* What would open nothing is not signed: a path that no dataset has, and a document, whose
 * addresses the signature would not open. */
static enum err_code sign_check(const struct router *routes, const char *path, struct err *e)
{
    union target_any any;
    const struct target *t = &any.all;
    enum err_code rc = router_read(routes, path, strlen(path), &any, e);
    if (rc)
        return err_add(e, "%s", path), rc;
    if (!(t->route->scope & SCOPE_DATASET))
        return err_set(e, ERR_ARG, "%s: no path of a dataset", path);
    if (route_redirects(t->route))
        return err_set(e, ERR_ARG,
                       "%s: it leads to the current revision: give the path with the revision, "
                       "/d/%s/r/REV/..., or sign the dataset (citysplat sign %s)",
                       path, t->names.ds, t->names.ds);
    if (route_names_others(t->route))
        return err_set(e, ERR_ARG,
                       "%s: it leads to other addresses, which this signature would not open: sign "
                       "the dataset (citysplat sign %s)",
                       path, t->names.ds);
    return ERR_OK;
}

static enum err_code sign_print(const struct sign_config *cfg, const struct auth *auth,
                                const struct router *routes, const char *what, struct err *e)
{
    const int64_t now_s = (int64_t)time(NULL), until_s = now_s + (int64_t)cfg->for_s;
    char query[AUTH_QUERY_MAX], seal[AUTH_SEAL_MAX], path[AUTH_SEAL_MAX + 32];
    const char *url = cfg->url ? cfg->url : "";
    const size_t n = strlen(url);
    enum err_code rc;
    if (what[0] == '/') {
        char *plain = mem_text(what); /* as the server reads it */
        rc = plain ? ERR_OK : err_set(e, ERR_MEM, "sign: out of memory");
        if (!rc) {
            router_unescape(plain);
            rc = sign_check(routes, plain, e);
        }
        if (!rc)
            rc = auth_sign_path(auth, cfg->key, plain, until_s, now_s, query, e);
        if (!rc)
            printf("%.*s%s%c%s\n", (int)(n && url[n - 1] == '/' ? n - 1 : n), url, plain,
                   strchr(plain, '?') ? '&' : '?', query);
        mem_free(plain);
        return rc;
    }
    rc = auth_sign(auth, cfg->key, (enum auth_scope)cfg->scope, what, until_s, now_s, seal, e);
    if (!rc)
        printf("%.*s%s\n", (int)(n && url[n - 1] == '/' ? n - 1 : n), url,
               link_text(link_signed, &(struct link){.from = LINK_ROOT, .up = "", .seal = seal},
                         path, sizeof path));
    return rc;
}

enum err_code cli_sign(int argc, char **argv, struct err *e)
{
    struct sign_config cfg;
    struct options_args args;
    struct arena arena = {0};
    struct auth *auth = NULL;
    struct router *routes = NULL;
    enum err_code rc = options_parse(&sign_spec, argc, argv, &cfg, &args, &arena, e);
    if (rc || args.done)
        goto out;
    if (!cfg.auth)
        rc = err_set(e, ERR_ARG, "--auth FILE is missing: it has the keys");
    if (!rc)
        rc = auth_open(cfg.auth, &auth, e);
    if (!rc)
        rc = router_open(ROUTES, ROUTES_COUNT, &routes, e);
    for (size_t i = 0; !rc && i < args.n; i++)
        rc = sign_print(&cfg, auth, routes, args.arg[i], e);
out:
    router_close(&routes);
    auth_close(&auth);
    arena_free(&arena);
    return rc;
}
