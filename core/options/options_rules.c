/* Rules between options (core/options/options_rules.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/options/options_rules.h"

#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/options/options_help.h"

enum options_verdict { OPTIONS_REFUSE, OPTIONS_WARN };

static const struct options_rule {
    const char *command, *a, *a_is, *b, *b_is;
    enum options_verdict verdict;
    const char *words;
} options_rules[] = {
#define RULE(command, a, a_is, b, b_is, verdict, words)                                            \
    {command, a, a_is, b, b_is, OPTIONS_##verdict, words},
#include "core/options/options_rules.def"
#undef RULE
};

static const struct options_def *options_rules_def(const struct options_spec *spec, const char *key)
{
    for (size_t i = 0; i < spec->n_defs; i++)
        if (*key && !strcmp(spec->defs[i].key, key))
            return &spec->defs[i];
    return NULL;
}

/* Does the value of `key` hold what `is` says: "set" differs from the default, "unset" does not,
 * any other text is the value itself. */
static bool options_rules_holds(const char *key, const char *is, const json_t *now,
                                const json_t *defaults)
{
    const json_t *v = json_object_get(now, key);
    bool same = json_equal(v, json_object_get(defaults, key));
    if (!strcmp(is, "set"))
        return !same;
    if (!strcmp(is, "unset"))
        return same;
    if (json_is_boolean(v))
        return json_is_true(v) == !strcmp(is, "true");
    if (json_is_string(v))
        return !strcmp(json_string_value(v), is);
    return json_is_number(v) && json_number_value(v) == strtod(is, NULL);
}

static enum err_code options_rules_one(const struct options_spec *spec,
                                       const struct options_rule *r, const json_t *now,
                                       const json_t *defaults, struct err *e)
{
    char a[OPTIONS_NAME_MAX], b[OPTIONS_NAME_MAX];
    if (!options_rules_def(spec, r->a) || !options_rules_def(spec, r->b))
        return err_set(e, ERR_INTERNAL, "a rule of %s names %s and %s", spec->command, r->a, r->b);
    if (!options_rules_holds(r->a, r->a_is, now, defaults) ||
        !options_rules_holds(r->b, r->b_is, now, defaults))
        return ERR_OK;
    options_help_flag(r->a, a);
    options_help_flag(r->b, b);
    if (r->verdict == OPTIONS_REFUSE)
        return err_set(e, ERR_ARG, "--%s and --%s: %s", a, b, r->words);
    log_warn(spec->command, "--%s and --%s: %s", a, b, r->words);
    return ERR_OK;
}

enum err_code options_rules_check(const struct options_spec *spec, const struct json_t *now,
                                  const struct json_t *defaults, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < sizeof options_rules / sizeof *options_rules; i++)
        if (!strcmp(options_rules[i].command, spec->command))
            rc = options_rules_one(spec, &options_rules[i], now, defaults, e);
    return rc;
}
