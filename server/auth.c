/* Tokens and signed addresses. A token is sent as Authorization: Bearer, never in an address,
 * because logs keep addresses; the file has only its SHA-256. A signed address is for clients that
 * cannot send headers (map engines, images). It is an HMAC-SHA256 over the path that it opens and
 * its end time, so one signature is enough for a tileset and all its tiles. Digests and comparison
 * are Nettle's. Compared values have a fixed length, and the time does not depend on them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/auth.h"

#include <jansson.h>
#include <nettle/base16.h>
#include <nettle/base64.h>
#include <nettle/hmac.h>
#include <nettle/memops.h>
#include <nettle/sha2.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

enum { AUTH_MAX = 256, AUTH_KEY_MIN = 32, AUTH_KEY_MAX = 256, AUTH_NAME = 64, AUTH_SCOPES = 16 };
enum { AUTH_SCOPE_TEXT = AUTH_NAME + 8, AUTH_SIG = BASE64_ENCODE_RAW_LENGTH(SHA256_DIGEST_SIZE) };

struct auth_key {
    char name[AUTH_NAME];
    uint8_t secret[AUTH_KEY_MAX];
    size_t n;
};
struct auth_token {
    uint8_t digest[SHA256_DIGEST_SIZE];
    char scope[AUTH_SCOPES][AUTH_SCOPE_TEXT];
    size_t n;
};
struct auth {
    struct auth_key key[AUTH_MAX];
    struct auth_token token[AUTH_MAX];
    char open[AUTH_MAX][AUTH_NAME];
    size_t n_keys, n_tokens, n_open;
};

/* ---- the file ---- */

static enum err_code auth_read_keys(struct auth *a, json_t *o, const char *path, struct err *e)
{
    const char *name;
    json_t *v;
    json_object_foreach(o, name, v)
    {
        size_t n = json_string_length(v);
        struct auth_key *k = &a->key[a->n_keys];
        if (a->n_keys == AUTH_MAX)
            return err_set(e, ERR_LIMIT, "%s: keys: more than %d", path, AUTH_MAX);
        if (!json_is_string(v) || n < AUTH_KEY_MIN || n > AUTH_KEY_MAX || !*name ||
            strlen(name) >= AUTH_NAME ||
            name[strspn(name, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")])
            return err_set(
                e, ERR_FORMAT,
                "%s: keys.%.40s: a key has a name of letters, digits, _ and -, and %d to "
                "%d characters (openssl rand -base64 48)",
                path, name, AUTH_KEY_MIN, AUTH_KEY_MAX);
        memcpy(k->name, name, strlen(name) + 1);
        memcpy(k->secret, json_string_value(v), n);
        k->n = n;
        a->n_keys++;
    }
    return ERR_OK;
}

static bool auth_scope_known(const char *s)
{
    return !strcmp(s, "admin") || (!strncmp(s, "read:", 5) && s[5]) ||
           (!strncmp(s, "render:", 7) && s[7]) || (!strncmp(s, "write:", 6) && s[6]);
}

static enum err_code auth_read_token(struct auth_token *t, const json_t *o, size_t index,
                                     const char *path, struct err *e)
{
    const char *hex = json_string_value(json_object_get(o, "sha256"));
    const json_t *scopes = json_object_get(o, "scope");
    struct base16_decode_ctx hexes;
    size_t n = sizeof t->digest;
    base16_decode_init(&hexes);
    if (!hex || strlen(hex) != 2 * sizeof t->digest ||
        !base16_decode_update(&hexes, &n, t->digest, strlen(hex), hex) ||
        !base16_decode_final(&hexes))
        return err_set(
            e, ERR_FORMAT,
            "%s: tokens[%zu].sha256: 64 hexadecimal digits (printf %%s TOKEN | sha256sum)", path,
            index);
    for (size_t i = 0; i < json_array_size(scopes); i++) {
        const char *s = json_string_value(json_array_get(scopes, i));
        if (!s || t->n == AUTH_SCOPES || strlen(s) >= AUTH_SCOPE_TEXT || !auth_scope_known(s))
            return err_set(e, ERR_FORMAT,
                           "%s: tokens[%zu].scope[%zu]: read:NAME, render:NAME, write:NAME or "
                           "admin, * for every "
                           "name, at most %d of them",
                           path, index, i, AUTH_SCOPES);
        memcpy(t->scope[t->n++], s, strlen(s) + 1);
    }
    return t->n ? ERR_OK
                : err_set(e, ERR_FORMAT, "%s: tokens[%zu].scope: a list of at least one", path,
                          index);
}

static enum err_code auth_read_open(struct auth *a, const json_t *list, const char *path,
                                    struct err *e)
{
    for (size_t i = 0; i < json_array_size(list); i++) {
        const char *s = json_string_value(json_array_get(list, i));
        if (!s || a->n_open == AUTH_MAX || strlen(s) >= AUTH_NAME)
            return err_set(e, ERR_FORMAT, "%s: public[%zu]: the name of a dataset", path, i);
        memcpy(a->open[a->n_open++], s, strlen(s) + 1);
    }
    return ERR_OK;
}

static enum err_code auth_read(struct auth *a, json_t *o, const char *path, struct err *e)
{
    const char *name;
    json_t *v;
    json_object_foreach(o, name, v)
    {
        bool list = !strcmp(name, "tokens") || !strcmp(name, "public");
        if (!list && strcmp(name, "keys") != 0)
            return err_set(e, ERR_FORMAT, "%s: %.40s: there are keys, tokens and public", path,
                           name);
        if (list ? !json_is_array(v) : !json_is_object(v))
            return err_set(e, ERR_FORMAT, "%s: %s: must be %s", path, name,
                           list ? "a list" : "an object");
    }
    const json_t *tokens = json_object_get(o, "tokens");
    enum err_code rc = auth_read_keys(a, json_object_get(o, "keys"), path, e);
    for (size_t i = 0; i < json_array_size(tokens) && !rc; i++)
        rc = i == AUTH_MAX
                 ? err_set(e, ERR_LIMIT, "%s: tokens: more than %d", path, AUTH_MAX)
                 : auth_read_token(&a->token[a->n_tokens++], json_array_get(tokens, i), i, path, e);
    return !rc ? auth_read_open(a, json_object_get(o, "public"), path, e) : rc;
}

enum err_code auth_parse(const char *text, size_t n, const char *name, struct auth **out,
                         struct err *e)
{
    struct auth *a = mem_array(1, sizeof *a);
    json_t *o = NULL;
    *out = a;
    if (!a)
        return err_set(e, ERR_MEM, "--auth: out of memory");
    enum err_code rc = jsonc_parse(text, n, name, &o, e);
    if (!rc && !json_is_object(o))
        rc = err_set(e, ERR_FORMAT, "%s: must be an object", name);
    if (!rc)
        rc = auth_read(a, o, name, e);
    json_decref(o);
    if (rc)
        auth_close(out);
    return rc;
}

enum err_code auth_open(const char *path, struct auth **out, struct err *e)
{
    struct buf b = {0};
    *out = NULL;
    enum err_code rc = file_read(path, 1 << 20, &b, e);
    if (!rc)
        rc = auth_parse((const char *)b.data, b.size, path, out, e);
    buf_free(&b);
    return rc;
}

void auth_close(struct auth **a)
{
    if (*a) /* secrets do not stay in memory that others get */
        memset(*a, 0, sizeof **a);
    mem_free(*a);
    *a = NULL;
}

/* ---- who may ---- */

bool auth_is_public(const struct auth *a, const char *ds)
{
    for (size_t i = 0; i < a->n_open; i++)
        if (!strcmp(a->open[i], ds) || !strcmp(a->open[i], "*"))
            return true;
    return false;
}

static bool auth_grants(const struct auth_token *t, enum auth_need need, const char *ds)
{
    const char *word = need == AUTH_RENDER ? "render:" : need == AUTH_WRITE ? "write:" : "read:";
    for (size_t i = 0; i < t->n; i++) {
        const char *s = t->scope[i], *of = s + strlen(word);
        if (need == AUTH_ADMIN
                ? !strcmp(s, "admin")
                : !strncmp(s, word, strlen(word)) && (!strcmp(of, "*") || !strcmp(of, ds)))
            return true;
    }
    return false;
}

/* All tokens are looked at, whichever it is. */
static enum auth_answer auth_check_token(const struct auth *a, enum auth_need need, const char *ds,
                                         const char *token)
{
    struct sha256_ctx h;
    uint8_t digest[SHA256_DIGEST_SIZE];
    enum auth_answer answer = AUTH_FORBIDDEN;
    sha256_init(&h);
    sha256_update(&h, strlen(token), (const uint8_t *)token);
    sha256_digest(&h, sizeof digest, digest);
    for (size_t i = 0; i < a->n_tokens; i++)
        if (memeql_sec(a->token[i].digest, digest, sizeof digest) &&
            auth_grants(&a->token[i], need, ds))
            answer = AUTH_OK;
    return answer;
}

struct auth_part { /* of a query; n 0: not there */
    const char *p;
    size_t n;
};

static struct auth_part auth_part(const char *query, size_t n, const char *name)
{
    size_t n_name = strlen(name);
    for (const char *p = query, *end = query + n; p < end;) {
        const char *amp = memchr(p, '&', (size_t)(end - p)), *stop = amp ? amp : end;
        if ((size_t)(stop - p) > n_name && !memcmp(p, name, n_name) && p[n_name] == '=')
            return (struct auth_part){p + n_name + 1, (size_t)(stop - p) - n_name - 1};
        p = amp ? amp + 1 : end;
    }
    return (struct auth_part){NULL, 0};
}

/* base64url without padding. */
static void auth_mac(const struct auth_key *k, const char *scope, size_t n_scope, int64_t exp_s,
                     char out[AUTH_SIG + 1])
{
    struct hmac_sha256_ctx h;
    uint8_t digest[SHA256_DIGEST_SIZE];
    char when[32];
    int n = snprintf(when, sizeof when, "\n%lld", (long long)exp_s);
    hmac_sha256_set_key(&h, k->n, k->secret);
    hmac_sha256_update(&h, n_scope, (const uint8_t *)scope);
    hmac_sha256_update(&h, (size_t)n, (const uint8_t *)when);
    hmac_sha256_digest(&h, sizeof digest, digest);
    base64_encode_raw(out, sizeof digest, digest);
    for (char *p = out; p < out + AUTH_SIG; p++)
        *p = *p == '+' ? '-' : *p == '/' ? '_' : *p;
    out[AUTH_SIG] = '\0';
}

static bool auth_read_time(struct auth_part t, int64_t *out)
{
    *out = 0;
    for (size_t i = 0; i < t.n; i++) {
        if (t.p[i] < '0' || t.p[i] > '9' || i > 15)
            return false;
        *out = *out * 10 + (t.p[i] - '0');
    }
    return t.n > 0;
}

static enum auth_answer auth_check_signature(const struct auth *a, struct auth_part sig,
                                             const char *path, size_t n_path, const char *query,
                                             size_t n_query, int64_t now_s)
{
    struct auth_part key = auth_part(query, n_query, "key"),
                     scope = auth_part(query, n_query, "scope"),
                     exp = auth_part(query, n_query, "exp");
    int64_t exp_s;
    char want[AUTH_SIG + 1];
    size_t n = AUTH_SIG - 1; /* 43 characters; the 44th is padding */
    if (sig.n != n || !auth_read_time(exp, &exp_s))
        return AUTH_FORBIDDEN;
    for (size_t i = 0; i < a->n_keys; i++) {
        const struct auth_key *k = &a->key[i];
        if (strlen(k->name) != key.n || memcmp(k->name, key.p, key.n) != 0)
            continue;
        auth_mac(k, scope.p ? scope.p : "", scope.n, exp_s, want);
        bool below = scope.n && scope.n <= n_path && !memcmp(scope.p, path, scope.n) &&
                     (scope.p[scope.n - 1] == '/' || scope.n == n_path);
        if (!memeql_sec(want, sig.p, n) || !below)
            return AUTH_FORBIDDEN;
        return now_s < exp_s ? AUTH_OK : AUTH_EXPIRED;
    }
    return AUTH_FORBIDDEN;
}

enum auth_answer auth_check(const struct auth *a, enum auth_need need, const char *ds,
                            const struct auth_request *r, int64_t now_s)
{
    const bool reads = need == AUTH_READ || need == AUTH_RENDER;
    if (reads && auth_is_public(a, ds))
        return AUTH_OK;
    if (r->authorization && !strncasecmp(r->authorization, "Bearer ", 7))
        return auth_check_token(a, need, ds ? ds : "", r->authorization + 7);
    struct auth_part sig = auth_part(r->query, r->n_query, "sig");
    if (reads && sig.n)
        return auth_check_signature(a, sig, r->path, r->n_path, r->query, r->n_query, now_s);
    return AUTH_UNKNOWN;
}

enum err_code auth_sign(const struct auth *a, const char *key, const char *scope, int64_t exp_s,
                        char out[AUTH_QUERY_MAX], struct err *e)
{
    const struct auth_key *k = NULL;
    char sig[AUTH_SIG + 1];
    for (size_t i = 0; i < a->n_keys; i++)
        if (key ? !strcmp(a->key[i].name, key) : a->n_keys == 1)
            k = &a->key[i];
    if (!k)
        return err_set(e, ERR_ARG, "--key %s: the file has %zu keys, and none of this name",
                       key ? key : "(none)", a->n_keys);
    if (scope[0] != '/' || strlen(scope) > 200 ||
        scope[strspn(scope,
                     "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789/_.,@:-")])
        return err_set(
            e, ERR_ARG,
            "--scope %s: a path of this server, as /d/NAME/ for a dataset with all below", scope);
    auth_mac(k, scope, strlen(scope), exp_s, sig);
    sig[AUTH_SIG - 1] = '\0';
    snprintf(out, AUTH_QUERY_MAX, "exp=%lld&key=%s&scope=%s&sig=%s", (long long)exp_s, k->name,
             scope, sig);
    return ERR_OK;
}
