/* Tokens, sessions and signed addresses. A token is sent as Authorization: Bearer, never in an
 * address, because logs keep addresses; the file has only its SHA-256. A session is a cookie that a
 * browser gets for a token. A signed address is for clients that cannot send either (map engines,
 * programs): a seal in front of all paths, which documents pass on because their addresses are
 * relative to it, or a signature in the query of one path. Seals and signatures are an HMAC-SHA256
 * over what they open and their end. The server keeps no list of them: a session ends when its
 * token or its key leaves the file. Digests and comparison are Nettle's. Compared values have a
 * fixed length, and the time does not depend on them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access/auth.h"

#include <jansson.h>
#include <nettle/base16.h>
#include <nettle/hmac.h>
#include <nettle/memops.h>
#include <nettle/sha2.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

enum { AUTH_MAX = 256, AUTH_KEY_MIN = 32, AUTH_KEY_MAX = 256, AUTH_NAME = 64, AUTH_SCOPES = 16 };
enum { AUTH_SCOPE_TEXT = AUTH_NAME + 8, AUTH_SIG = (SHA256_DIGEST_SIZE + 2) / 3 * 4 };
enum { AUTH_AGE_S = 30 * 86400, AUTH_AGE_MAX_S = 366 * 86400, AUTH_SESSION_S = 12 * 3600 };
enum { AUTH_SKEW_S = 60 }; /* clocks of who signs and who checks may differ by so much */
enum { AUTH_TOKEN_ID = 16, AUTH_PARTS = 5 };
const char AUTH_COOKIE[] = "citysplat";
static const char AUTH_SESSION[] = "session"; /* the word of a cookie's seal */
/* Words of seals in addresses, and what they open. */
static const struct {
    const char *word;
    bool reads, renders;
} auth_scopes[] = {[AUTH_SCOPE_READ] = {"read", true, false},
                   [AUTH_SCOPE_RENDER] = {"render", false, true},
                   [AUTH_SCOPE_BOTH] = {"read-render", true, true}};

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
    _Atomic size_t refs;
    struct hash128 text; /* of the file */
    int64_t max_age_s, session_s;
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

static enum err_code auth_check_member(const char *name, const json_t *v, const char *path,
                                       struct err *e)
{
    const bool list = !strcmp(name, "tokens") || !strcmp(name, "public"),
               time = !strcmp(name, "max_age_s") || !strcmp(name, "session_s");
    if (!list && !time && strcmp(name, "keys") != 0)
        return err_set(e, ERR_FORMAT,
                       "%s: %.40s: there are keys, tokens, public, max_age_s and session_s", path,
                       name);
    if (time && !(json_is_integer(v) && json_integer_value(v) >= AUTH_SKEW_S &&
                  json_integer_value(v) <= AUTH_AGE_MAX_S))
        return err_set(e, ERR_FORMAT, "%s: %s: a whole number of seconds, %d to %d", path, name,
                       AUTH_SKEW_S, AUTH_AGE_MAX_S);
    if (!time && (list ? !json_is_array(v) : !json_is_object(v)))
        return err_set(e, ERR_FORMAT, "%s: %s: must be %s", path, name,
                       list ? "a list" : "an object");
    return ERR_OK;
}

static enum err_code auth_read(struct auth *a, json_t *o, const char *path, struct err *e)
{
    const char *name;
    json_t *v;
    json_object_foreach(o, name, v)
    {
        if (auth_check_member(name, v, path, e))
            return ERR_FORMAT;
    }
    if ((v = json_object_get(o, "max_age_s")) != NULL)
        a->max_age_s = json_integer_value(v);
    if ((v = json_object_get(o, "session_s")) != NULL)
        a->session_s = json_integer_value(v);
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
    atomic_init(&a->refs, 1);
    a->text = hash_bytes(text, n);
    a->max_age_s = AUTH_AGE_S;
    a->session_s = AUTH_SESSION_S;
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
    enum err_code rc = file_check_secret(path, "--auth", e);
    if (!rc)
        rc = file_read(path, 1 << 20, &b, e);
    if (!rc)
        rc = auth_parse((const char *)b.data, b.size, path, out, e);
    buf_free(&b);
    return rc;
}

struct auth *auth_ref(struct auth *a)
{
    if (a)
        atomic_fetch_add_explicit(&a->refs, 1, memory_order_relaxed);
    return a;
}

void auth_close(struct auth **out)
{
    struct auth *a = *out;
    *out = NULL;
    if (!a || atomic_fetch_sub_explicit(&a->refs, 1, memory_order_acq_rel) != 1)
        return;
    memset(a, 0, sizeof *a); /* secrets do not stay in memory that others get */
    mem_free(a);
}

bool auth_is_same(const struct auth *a, const struct auth *b)
{
    return a->text.lo == b->text.lo && a->text.hi == b->text.hi;
}

/* ---- tokens ---- */

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

static void auth_digest(const char *token, uint8_t out[SHA256_DIGEST_SIZE])
{
    struct sha256_ctx h;
    sha256_init(&h);
    sha256_update(&h, strlen(token), (const uint8_t *)token);
    sha256_digest(&h, SHA256_DIGEST_SIZE, out);
}

/* All tokens are looked at, whichever it is. */
static enum auth_answer auth_check_token(const struct auth *a, enum auth_need need, const char *ds,
                                         const char *token)
{
    uint8_t digest[SHA256_DIGEST_SIZE];
    enum auth_answer answer = AUTH_FORBIDDEN;
    auth_digest(token, digest);
    for (size_t i = 0; i < a->n_tokens; i++)
        if (memeql_sec(a->token[i].digest, digest, sizeof digest) &&
            auth_grants(&a->token[i], need, ds))
            answer = AUTH_OK;
    return answer;
}

/* ---- signatures ---- */

enum { AUTH_TEXT = 2048 + 1 }; /* as long as a target may be */

/* What a signature of one path covers: the path, and behind '?' the query without the signature
 * itself and without v=, which clients add for caches. Returns the length; 0: it is too long. */
static size_t auth_text(const char *path, size_t n_path, const char *query, size_t n_query,
                        char out[AUTH_TEXT])
{
    static const char *const left_out[] = {"exp=", "key=", "sig=", "v="};
    size_t n = n_path;
    char sign = '?';
    if (n_path + n_query + 1 >= AUTH_TEXT)
        return 0;
    memcpy(out, path, n_path);
    for (const char *p = query, *end = query + n_query; p < end;) {
        const char *amp = memchr(p, '&', (size_t)(end - p)), *stop = amp ? amp : end;
        const size_t m = (size_t)(stop - p);
        bool covered = m > 0;
        for (size_t i = 0; i < sizeof left_out / sizeof *left_out; i++)
            covered &= m < strlen(left_out[i]) || memcmp(p, left_out[i], strlen(left_out[i])) != 0;
        if (covered) {
            out[n++] = sign;
            memcpy(out + n, p, m);
            n += m;
            sign = '&';
        }
        p = amp ? amp + 1 : end;
    }
    return n;
}

struct auth_part { /* of a query or a seal; n 0: not there */
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

static bool auth_part_is(struct auth_part p, const char *word)
{
    return p.p && p.n == strlen(word) && !memcmp(p.p, word, p.n);
}

/* base64url without padding, of "WHAT" or "WORD.NAME", a newline and the time. */
static void auth_mac(const struct auth_key *k, struct auth_part what, int64_t exp_s,
                     char out[AUTH_SIG + 1])
{
    struct hmac_sha256_ctx h;
    uint8_t digest[SHA256_DIGEST_SIZE];
    char when[32];
    int n = snprintf(when, sizeof when, "\n%lld", (long long)exp_s);
    hmac_sha256_set_key(&h, k->n, k->secret);
    hmac_sha256_update(&h, what.n, (const uint8_t *)what.p);
    hmac_sha256_update(&h, (size_t)n, (const uint8_t *)when);
    hmac_sha256_digest(&h, sizeof digest, digest);
    base64_write(digest, sizeof digest, BASE64_URL, out);
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

/* Did the key sign `what`, and does it hold now? */
static enum auth_answer auth_verify(const struct auth *a, struct auth_part key,
                                    struct auth_part exp, struct auth_part what,
                                    struct auth_part sig, int64_t now_s)
{
    int64_t exp_s;
    char want[AUTH_SIG + 1];
    if (sig.n != AUTH_SIG - 1 || !auth_read_time(exp, &exp_s))
        return AUTH_FORBIDDEN;
    for (size_t i = 0; i < a->n_keys; i++) {
        if (!auth_part_is(key, a->key[i].name))
            continue;
        auth_mac(&a->key[i], what, exp_s, want);
        if (!memeql_sec(want, sig.p, sig.n))
            return AUTH_FORBIDDEN;
        return now_s >= exp_s                               ? AUTH_EXPIRED
               : exp_s - now_s > a->max_age_s + AUTH_SKEW_S ? AUTH_LONG
                                                            : AUTH_OK;
    }
    return AUTH_FORBIDDEN;
}

enum { AUTH_SEAL_KEY, AUTH_SEAL_EXP, AUTH_SEAL_WORD, AUTH_SEAL_NAME, AUTH_SEAL_SIG };

static enum auth_answer auth_read_seal(const struct auth *a, const char *seal, size_t n,
                                       int64_t now_s, struct auth_part part[AUTH_PARTS])
{
    const char *end = seal + n;
    for (int i = 0; i < AUTH_PARTS; i++) {
        const char *dot = i < AUTH_PARTS - 1 ? memchr(seal, '.', (size_t)(end - seal)) : end;
        if (!dot)
            return AUTH_FORBIDDEN;
        part[i] = (struct auth_part){seal, (size_t)(dot - seal)};
        seal = dot + (dot < end);
    }
    const struct auth_part what = {part[AUTH_SEAL_WORD].p,
                                   part[AUTH_SEAL_WORD].n + 1 + part[AUTH_SEAL_NAME].n};
    return auth_verify(a, part[AUTH_SEAL_KEY], part[AUTH_SEAL_EXP], what, part[AUTH_SEAL_SIG],
                       now_s);
}

/* The scope that a word means; AUTH_SCOPE_BOTH + 1: none. */
static size_t auth_scope_of(struct auth_part word)
{
    size_t i = 0;
    while (i <= AUTH_SCOPE_BOTH && !auth_part_is(word, auth_scopes[i].word))
        i++;
    return i;
}

enum auth_answer auth_check_seal(const struct auth *a, const char *seal, size_t n, int64_t now_s)
{
    struct auth_part part[AUTH_PARTS];
    const enum auth_answer answer = auth_read_seal(a, seal, n, now_s, part);
    return answer || auth_scope_of(part[AUTH_SEAL_WORD]) <= AUTH_SCOPE_BOTH ? answer
                                                                            : AUTH_FORBIDDEN;
}

static enum auth_answer auth_open_seal(const struct auth *a, enum auth_need need, const char *ds,
                                       const struct auth_request *r, int64_t now_s)
{
    struct auth_part part[AUTH_PARTS];
    const enum auth_answer answer = auth_read_seal(a, r->seal, r->n_seal, now_s, part);
    if (answer)
        return answer;
    const size_t scope = auth_scope_of(part[AUTH_SEAL_WORD]);
    return scope <= AUTH_SCOPE_BOTH && auth_part_is(part[AUTH_SEAL_NAME], ds) &&
                   (need == AUTH_RENDER ? auth_scopes[scope].renders : auth_scopes[scope].reads)
               ? AUTH_OK
               : AUTH_FORBIDDEN;
}

/* ---- sessions ---- */

static void auth_token_id(const struct auth_token *t, char out[2 * AUTH_TOKEN_ID + 1])
{
    base16_encode_update(out, AUTH_TOKEN_ID, t->digest);
    out[2 * AUTH_TOKEN_ID] = '\0';
}

/* The value of our cookie among all that the client sent. */
static struct auth_part auth_cookie(const char *cookies)
{
    const size_t n = strlen(AUTH_COOKIE);
    for (const char *p = cookies; p && *p; p = strchr(p, ';'), p = p ? p + 1 : NULL) {
        p += strspn(p, " \t");
        if (!strncmp(p, AUTH_COOKIE, n) && p[n] == '=')
            return (struct auth_part){p + n + 1, strcspn(p + n + 1, "; \t")};
    }
    return (struct auth_part){NULL, 0};
}

/* A session that is over, or whose token or key has gone, is no credential any more. */
static enum auth_answer auth_check_session(const struct auth *a, enum auth_need need,
                                           const char *ds, struct auth_part cookie, int64_t now_s)
{
    struct auth_part part[AUTH_PARTS];
    char id[2 * AUTH_TOKEN_ID + 1];
    if (auth_read_seal(a, cookie.p, cookie.n, now_s, part) ||
        !auth_part_is(part[AUTH_SEAL_WORD], AUTH_SESSION))
        return AUTH_UNKNOWN;
    for (size_t i = 0; i < a->n_tokens; i++) {
        auth_token_id(&a->token[i], id);
        if (auth_part_is(part[AUTH_SEAL_NAME], id))
            return auth_grants(&a->token[i], need, ds) ? AUTH_OK : AUTH_FORBIDDEN;
    }
    return AUTH_UNKNOWN;
}

/* ---- who may ---- */

enum auth_answer auth_check(const struct auth *a, enum auth_need need, const char *ds,
                            const struct auth_request *r, int64_t now_s)
{
    const bool reads = need == AUTH_READ || need == AUTH_RENDER;
    if (reads && auth_is_public(a, ds))
        return AUTH_OK;
    if (r->authorization && !strncasecmp(r->authorization, "Bearer ", 7))
        return auth_check_token(a, need, ds ? ds : "", r->authorization + 7);
    if (!reads)
        return AUTH_UNKNOWN;
    if (r->seal)
        return auth_open_seal(a, need, ds, r, now_s);
    const struct auth_part sig = auth_part(r->query, r->n_query, "sig"),
                           cookie = auth_cookie(r->cookie);
    char text[AUTH_TEXT];
    const size_t n = sig.n ? auth_text(r->path, r->n_path, r->query, r->n_query, text) : 0;
    if (sig.n)
        return r->names_others || !n ? AUTH_FORBIDDEN
                                     : auth_verify(a, auth_part(r->query, r->n_query, "key"),
                                                   auth_part(r->query, r->n_query, "exp"),
                                                   (struct auth_part){text, n}, sig, now_s);
    return cookie.n ? auth_check_session(a, need, ds, cookie, now_s) : AUTH_UNKNOWN;
}

/* ---- making them ---- */

static enum err_code auth_find_key(const struct auth *a, const char *key, int64_t exp_s,
                                   int64_t now_s, const struct auth_key **out, struct err *e)
{
    *out = NULL;
    for (size_t i = 0; i < a->n_keys; i++)
        if (key ? !strcmp(a->key[i].name, key) : a->n_keys == 1)
            *out = &a->key[i];
    if (!*out)
        return err_set(e, ERR_ARG, "--key %s: the file has %zu keys, and none of this name",
                       key ? key : "(none)", a->n_keys);
    if (exp_s - now_s > a->max_age_s)
        return err_set(e, ERR_ARG,
                       "--for-s %lld: the server takes no signature that holds for more than %lld "
                       "s (max_age_s of the file)",
                       (long long)(exp_s - now_s), (long long)a->max_age_s);
    return ERR_OK;
}

static void auth_make_seal(const struct auth_key *k, const char *word, const char *name,
                           int64_t exp_s, char out[AUTH_SEAL_MAX])
{
    char what[AUTH_SEAL_MAX], sig[AUTH_SIG + 1];
    const int n = snprintf(what, sizeof what, "%s.%s", word, name);
    auth_mac(k, (struct auth_part){what, (size_t)n}, exp_s, sig);
    snprintf(out, AUTH_SEAL_MAX, "%s.%lld.%.80s.%s", k->name, (long long)exp_s, what, sig);
}

static bool auth_is_name(const char *ds)
{
    const size_t n = strlen(ds);
    return n && n < AUTH_NAME && *ds != '-' && *ds != '_' &&
           strspn(ds, "abcdefghijklmnopqrstuvwxyz0123456789_-") == n;
}

enum err_code auth_sign(const struct auth *a, const char *key, enum auth_scope scope,
                        const char *ds, int64_t exp_s, int64_t now_s, char out[AUTH_SEAL_MAX],
                        struct err *e)
{
    const struct auth_key *k;
    if (!auth_is_name(ds))
        return err_set(e, ERR_ARG,
                       "%.80s: no name of a dataset: one of at most %d of a-z, 0-9, _ "
                       "and -",
                       ds, AUTH_NAME - 1);
    enum err_code rc = auth_find_key(a, key, exp_s, now_s, &k, e);
    if (!rc)
        auth_make_seal(k, auth_scopes[scope].word, ds, exp_s, out);
    return rc;
}

enum err_code auth_sign_path(const struct auth *a, const char *key, const char *path, int64_t exp_s,
                             int64_t now_s, char out[AUTH_QUERY_MAX], struct err *e)
{
    const struct auth_key *k;
    char sig[AUTH_SIG + 1], text[AUTH_TEXT];
    const size_t n_path = strcspn(path, "?"),
                 n_query = path[n_path] ? strlen(path + n_path + 1) : 0;
    const size_t n = auth_text(path, n_path, path + n_path + (path[n_path] != 0), n_query, text);
    if (path[0] != '/' || !n || n + AUTH_QUERY_MAX >= AUTH_TEXT)
        return err_set(e, ERR_ARG,
                       "%.80s: no path of a server: one begins with / and has at most %d bytes",
                       path, AUTH_TEXT - AUTH_QUERY_MAX - 1);
    enum err_code rc = auth_find_key(a, key, exp_s, now_s, &k, e);
    if (rc)
        return rc;
    auth_mac(k, (struct auth_part){text, n}, exp_s, sig);
    snprintf(out, AUTH_QUERY_MAX, "exp=%lld&key=%s&sig=%s", (long long)exp_s, k->name, sig);
    return ERR_OK;
}

enum auth_answer auth_session(const struct auth *a, const char *token, int64_t now_s,
                              char out[AUTH_SEAL_MAX], int64_t *for_s)
{
    uint8_t digest[SHA256_DIGEST_SIZE];
    char id[2 * AUTH_TOKEN_ID + 1];
    const struct auth_token *found = NULL;
    auth_digest(token, digest);
    for (size_t i = 0; i < a->n_tokens; i++)
        if (memeql_sec(a->token[i].digest, digest, sizeof digest))
            found = &a->token[i];
    if (!a->n_keys)
        return AUTH_UNKNOWN;
    if (!found)
        return AUTH_FORBIDDEN;
    *for_s = a->session_s < a->max_age_s ? a->session_s : a->max_age_s;
    auth_token_id(found, id);
    auth_make_seal(&a->key[0], AUTH_SESSION, id, now_s + *for_s, out);
    return AUTH_OK;
}
